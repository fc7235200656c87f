// An ordinary roscpp program, as anybody writes it: it knows nothing of rossec.
//   talker TOPIC [SIZE RATE]   publishes the parameter ~word and a number, padded to SIZE
//   listener TOPIC [COUNT]     prints what it hears, the first 40 characters
//   both TOPIC [COUNT]         subscribes to what it publishes itself
//   flood TOPIC SIZE RATE      publishes its clock while somebody listens
//   sink TOPIC SECONDS         counts what arrives, and how old it is
// All offer the service ~say; not one of roscpp's own, which crash with Debian's log4cxx.
#include <algorithm>
#include <vector>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <roscpp/SetLoggerLevel.h>
#include <std_msgs/String.h>

static int heard = 0, wanted = 0;

static void hear(const std_msgs::String::ConstPtr& message) {
  std::printf("HEARD %s\n", message->data.substr(0, 40).c_str());
  std::fflush(stdout);
  if (++heard == wanted) ros::shutdown();
}

static bool say(roscpp::SetLoggerLevelRequest& asked, roscpp::SetLoggerLevelResponse&) {
  std::printf("ASKED %s %s\n", asked.logger.c_str(), asked.level.c_str());
  std::fflush(stdout);
  return true;
}

static int flood(ros::NodeHandle& node, const std::string& topic, size_t size, double pace) {
  ros::Publisher publisher = node.advertise<std_msgs::String>(topic, 100);
  std_msgs::String message;
  message.data.assign(size, '.');
  ros::WallDuration pause(1 / pace);
  while (ros::ok()) {
    if (publisher.getNumSubscribers() == 0) {
      ros::WallDuration(0.02).sleep();
    } else {
      std::snprintf(&message.data[0], 24, "%023llu",
                    (unsigned long long)ros::WallTime::now().toNSec());
      publisher.publish(message);
      if (pace < 1e5) pause.sleep();
    }
    ros::spinOnce();
  }
  return 0;
}

static std::vector<double> ages;
static size_t bytes = 0;

static void weigh(const std_msgs::String::ConstPtr& message) {
  bytes += message->data.size();
  ages.push_back((ros::WallTime::now().toNSec() - std::strtoull(message->data.c_str(), 0, 10)) / 1e3);
}

static int sink(ros::NodeHandle& node, const std::string& topic, double seconds) {
  ros::Subscriber subscriber =
      node.subscribe(topic, 1000, weigh, ros::TransportHints().tcpNoDelay());
  while (ros::ok() && ages.size() < 20) ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
  ages.clear();
  bytes = 0;
  const ros::WallTime begin = ros::WallTime::now();
  while (ros::ok() && (ros::WallTime::now() - begin).toSec() < seconds)
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.01));
  const double took = (ros::WallTime::now() - begin).toSec();
  std::nth_element(ages.begin(), ages.begin() + ages.size() / 2, ages.end());
  std::printf("{\"bytes_per_s\": %f, \"messages_per_s\": %f, \"age_us\": %f}\n", bytes / took,
              ages.size() / took, ages.empty() ? -1 : ages[ages.size() / 2]);
  return 0;
}

int main(int argc, char** argv) {
  const std::string mode = argc > 1 ? argv[1] : "";
  ros::init(argc, argv, mode == "listener" ? "listener" : "talker");
  ros::NodeHandle node, own("~");
  const std::string topic = argc > 2 ? argv[2] : "/chatter";
  if (mode == "flood") return flood(node, topic, std::atoi(argv[3]), std::atof(argv[4]));
  if (mode == "sink") return sink(node, topic, std::atof(argv[3]));
  ros::ServiceServer service = own.advertiseService("say", say);
  ros::Subscriber subscriber;
  if (mode != "talker") {
    wanted = argc > 3 ? std::atoi(argv[3]) : 0;
    subscriber = node.subscribe(topic, 100, hear, ros::TransportHints().tcpNoDelay());
  }
  if (mode == "listener") {
    ros::spin();
    return heard >= wanted ? 0 : 3;
  }
  ros::Publisher publisher = node.advertise<std_msgs::String>(topic, 100);
  const size_t size = mode == "talker" && argc > 3 ? std::atoi(argv[3]) : 0;
  ros::Rate rate(mode == "talker" && argc > 4 ? std::atof(argv[4]) : 20);
  for (int number = 0; ros::ok(); ++number) {
    std::string word = "hello";
    own.getParamCached("word", word);
    std_msgs::String message;
    message.data = word + " " + std::to_string(number);
    if (message.data.size() < size) message.data.resize(size, '.');
    publisher.publish(message);
    ROS_INFO_THROTTLE(1, "still here");
    ros::spinOnce();
    rate.sleep();
  }
  return 0;
}
