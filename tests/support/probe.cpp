// An ordinary roscpp program, as anybody writes it: it knows nothing of rossec.
//   talker TOPIC [SIZE RATE]   publishes the parameter ~word and a number, padded to SIZE
//   listener TOPIC [COUNT]     prints what it hears, the first 40 characters
//   both TOPIC [COUNT]         subscribes to what it publishes itself
//   caller SERVICE COUNT       calls a ~say: once, then so often over one connection
//   searcher KEY               prints where the parameter KEY is, from its namespace upwards
// All offer the service ~say; not one of roscpp's own, which crash with Debian's log4cxx.
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

static int call(ros::NodeHandle& node, const std::string& name, int count) {
  if (!ros::service::waitForService(name, ros::Duration(30))) return 4;
  roscpp::SetLoggerLevel words;
  words.request.logger = "once";
  if (!ros::service::call(name, words)) return 5;
  auto kept = node.serviceClient<roscpp::SetLoggerLevel>(name, true);
  for (int number = 0; number < count; ++number) {
    words.request.logger = "kept " + std::to_string(number);
    if (!kept.call(words)) return 6;
  }
  return kept.isValid() ? 0 : 7;
}

int main(int argc, char** argv) {
  const std::string mode = argc > 1 ? argv[1] : "";
  ros::init(argc, argv, mode == "both" ? "talker" : mode);
  ros::NodeHandle node, own("~");
  if (mode == "searcher") {
    std::string found;
    if (!node.searchParam(argv[2], found)) return 8;
    std::printf("FOUND %s\n", found.c_str());
    return 0;
  }
  const std::string topic = argc > 2 ? argv[2] : "/chatter";
  ros::ServiceServer service = own.advertiseService("say", say);
  if (mode == "caller") return call(node, topic, std::atoi(argv[3]));
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
