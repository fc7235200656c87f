// A nodelet as anybody writes it: what it hears on `in` it says louder on `~out`.
#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/ros.h>
#include <std_msgs/String.h>

namespace shout {

class Shout : public nodelet::Nodelet {
  void onInit() override {
    publisher_ = getPrivateNodeHandle().advertise<std_msgs::String>("out", 10);
    subscriber_ = getNodeHandle().subscribe("in", 10, &Shout::hear, this);
  }

  void hear(const std_msgs::String::ConstPtr& message) {
    std_msgs::StringPtr louder(new std_msgs::String);
    louder->data = message->data + "!";
    publisher_.publish(louder);
  }

  ros::Publisher publisher_;
  ros::Subscriber subscriber_;
};

}  // namespace shout

PLUGINLIB_EXPORT_CLASS(shout::Shout, nodelet::Nodelet)
