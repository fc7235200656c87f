// Two ordinary roscpp programs that measure the way between them: they know nothing of rossec.
//   flood TOPIC SIZE RATE   publishes its clock while it has a subscriber; RATE 0: as fast as that receives
//   sink                    for each line "TOPIC SECONDS" on its input: counts what arrives, and how old it is
#include <fcntl.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_msgs/String.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <iostream>
#include <vector>

// The number of the last message that was heard, in a file which both ends map. A talker that knows it never
// publishes what its queue would drop, so that the way is measured and not how the kernel shares out the cores.
static volatile long long* confirmed(std::string topic) {
  std::replace(topic.begin(), topic.end(), '/', '_');
  const std::string name = std::string(std::getenv("ROS_HOME")) + "/heard" + topic;
  const int file = open(name.c_str(), O_RDWR | O_CREAT, 0600);
  if (file < 0 || ftruncate(file, sizeof(long long)) != 0) std::abort();
  void* place = mmap(0, sizeof(long long), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  close(file);
  return static_cast<volatile long long*>(place);
}

static int flood(ros::NodeHandle& node, const std::string& topic, size_t size, double pace) {
  ros::Publisher publisher = node.advertise<std_msgs::String>(topic, 1000);
  const long long window = std::min<long long>(1000, 8000000 / size);
  volatile long long* heard = confirmed(topic);
  long long number = 0;
  std_msgs::String message;
  message.data.assign(size, '.');
  while (ros::ok()) {
    if (publisher.getNumSubscribers() == 0) {
      number = *heard;
      ros::WallDuration(0.02).sleep();
    } else {
      std::snprintf(&message.data[0], 44, "%020llu %020lld",
                    (unsigned long long)ros::WallTime::now().toNSec(), ++number);
      publisher.publish(message);
      if (pace > 0) ros::WallDuration(1 / pace).sleep();
      // Not for ever: messages published before the connection are lost.
      else for (int turn = 0; turn < 200 && number - *heard >= window; ++turn) usleep(50);
    }
    ros::spinOnce();
  }
  return 0;
}

static std::vector<double> ages;
static size_t bytes = 0;
static volatile long long* heard_so_far = 0;

static void weigh(const std_msgs::String::ConstPtr& message) {
  char* rest = 0;
  const unsigned long long sent = std::strtoull(message->data.c_str(), &rest, 10);
  *heard_so_far = std::strtoll(rest, 0, 10);
  bytes += message->data.size();
  ages.push_back((ros::WallTime::now().toNSec() - sent) / 1e3);
}

static void weigh_for(ros::NodeHandle& node, const std::string& topic, double seconds) {
  heard_so_far = confirmed(topic);
  ages.clear();
  ros::Subscriber subscriber =
      node.subscribe(topic, 1000, weigh, ros::TransportHints().tcpNoDelay());
  while (ros::ok() && ages.size() < 20) ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
  std::puts("begin");
  std::fflush(stdout);
  ages.clear();
  bytes = 0;
  const ros::WallTime begin = ros::WallTime::now();
  while (ros::ok() && (ages.empty() || (ros::WallTime::now() - begin).toSec() < seconds))
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.01));
  const double took = (ros::WallTime::now() - begin).toSec();
  std::nth_element(ages.begin(), ages.begin() + ages.size() / 2, ages.end());
  std::printf("{\"mb_per_s\": %f, \"age_us\": %f, \"messages\": %zu}\n", bytes / took / 1e6,
              ages[ages.size() / 2], ages.size());
  std::fflush(stdout);
}

static int sink(ros::NodeHandle& node) {
  std::string topic;
  double seconds;
  while (std::cin >> topic >> seconds) weigh_for(node, topic, seconds);
  return 0;
}

int main(int argc, char** argv) {
  const std::string mode = argc > 1 ? argv[1] : "";
  ros::init(argc, argv, mode);
  ros::NodeHandle node;
  if (mode == "sink") return sink(node);
  return argc > 4 ? flood(node, argv[2], std::atoi(argv[3]), std::atof(argv[4])) : 2;
}
