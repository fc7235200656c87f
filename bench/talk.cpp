// An ordinary roscpp program for `bench/sidecar.py`, told on its standard input what to do.
//   publisher       "KIND SIZE COUNT": publishes that; answers "BEGAN <monotonic seconds>"
//   subscriber      "COUNT": counts anew, answers "ARMED", then "DONE <monotonic seconds>";
//                   "delays": answers with the microseconds each paced message took
#include <ros/ros.h>
#include <std_msgs/String.h>
#include <ctime>
#include <iostream>
#include <mutex>
#include <sstream>
#include <vector>

static std::mutex lock;
static long wanted = 0, seen = 0;
static std::vector<double> delays;

static double monotonic() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + now.tv_nsec / 1e9;
}

static void say(const std::string& line) {
  std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

static std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9f", value);
  return text;
}

static void hear(const std_msgs::String::ConstPtr& message) {
  const double now = monotonic();
  std::lock_guard<std::mutex> held(lock);
  if (message->data.size() < 32) delays.push_back((now - std::atof(message->data.c_str())) * 1e6);
  if (++seen == wanted) say("DONE " + number(now));
}

static void publish(ros::NodeHandle& node) {
  ros::Publisher publisher = node.advertise<std_msgs::String>("/bench/text", 0);
  say("READY");
  std::string kind;
  for (long size, count; std::cin >> kind >> size >> count;) {
    while (publisher.getNumSubscribers() < 1) ros::WallDuration(0.01).sleep();
    std_msgs::String message;
    message.data.assign(size, 'x');
    const double begin = monotonic();
    for (long sent = 0; sent < count; ++sent) {
      if (kind == "time") {
        message.data = number(monotonic());
        publisher.publish(message);
        ros::WallDuration(0.01).sleep();
      } else {
        publisher.publish(message);
      }
    }
    say("BEGAN " + number(begin));
  }
}

static void subscribe(ros::NodeHandle& node) {
  ros::Subscriber subscriber =
      node.subscribe("/bench/text", 0, hear, ros::TransportHints().tcpNoDelay());
  say("READY");
  for (std::string line; std::getline(std::cin, line);) {
    std::lock_guard<std::mutex> held(lock);
    if (line == "delays") {
      std::ostringstream all;
      for (double delay : delays) all << (all.tellp() > 0 ? ", " : "") << delay;
      say("DELAYS [" + all.str() + "]");
      delays.clear();
    } else {
      seen = 0;
      wanted = std::atol(line.c_str());
      say("ARMED");
    }
  }
}

int main(int argc, char** argv) {
  const bool publishes = argc > 1 && std::string(argv[1]) == "publisher";
  ros::init(argc, argv, publishes ? "bench_publisher" : "bench_subscriber",
            ros::init_options::NoRosout);
  ros::NodeHandle node;
  ros::AsyncSpinner spinner(1);
  spinner.start();
  publishes ? publish(node) : subscribe(node);
  return 0;
}
