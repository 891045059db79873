// robot_localization's EKF over a drive in a file, without DDS: its own callbacks and its own timer, called in the order
// of arrival with the simulated time of each.
//
//   runner DRIVE ESTIMATES --ros-args --params-file SETTINGS
//
// DRIVE, in the order of arrival, times in ns:
//   arrival,odom,stamp,v,omega,var_v,cov,var_omega,var_lateral
//   arrival,pose,stamp,x,y,yaw,var_x,var_y,var_yaw
//   arrival,imu,stamp,rate,variance
// ESTIMATES: stamp,x,y,yaw,xx,xy,xt,yy,yt,tt for each tick of its timer. The last line on stderr is the
// version of robot_localization and its CPU time [s].

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "geometry_msgs/msg/pose_with_covariance_stamped.hpp"
#include "nav_msgs/msg/odometry.hpp"
#include "rcl/time.h"
#include "rclcpp/rclcpp.hpp"
#include "robot_localization/filter_common.hpp"
#include "robot_localization/ros_filter_types.hpp"
#include "sensor_msgs/msg/imu.hpp"

using robot_localization::CallbackData;
using robot_localization::RosEkf;

namespace
{

double cpu_time()
{
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

// What a callback is told of a source: the part of its configuration that is a pose or a twist.
CallbackData part_of(RosEkf & node, const std::string & source, int offset, int size, const std::string & part)
{
  std::vector<bool> used(robot_localization::STATE_SIZE, false);
  const auto config = node.get_parameter(source + "_config").as_bool_array();
  std::copy(config.begin() + offset, config.begin() + offset + size, used.begin() + offset);
  const int count = std::count(used.begin(), used.end(), true);
  const bool is_pose = offset == robot_localization::POSITION_OFFSET;
  const std::string threshold = source == "pose0" ? "pose0_rejection_threshold" : source + "_" + part + "_rejection_threshold";
  return CallbackData(
    source + "_" + part, used, count, is_pose && node.get_parameter(source + "_differential").as_bool(),
    is_pose && node.get_parameter(source + "_relative").as_bool(), false, node.get_parameter(threshold).as_double());
}

CallbackData pose_of(RosEkf & node, const std::string & source)
{
  return part_of(node, source, robot_localization::POSITION_OFFSET, robot_localization::POSE_SIZE, "pose");
}

CallbackData twist_of(RosEkf & node, const std::string & source)
{
  return part_of(node, source, robot_localization::POSITION_V_OFFSET, robot_localization::TWIST_SIZE, "twist");
}

rclcpp::Time stamp_of(int64_t ns)
{
  return rclcpp::Time(ns, RCL_ROS_TIME);
}

}  // namespace

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  const auto args = rclcpp::remove_ros_arguments(argc, argv);
  if (args.size() != 3) {
    fprintf(stderr, "usage: runner DRIVE ESTIMATES --ros-args --params-file SETTINGS\n");
    return 1;
  }
  std::ifstream drive(args[1]);
  FILE * estimates = fopen(args[2].c_str(), "w");
  std::string line;
  if (!estimates || !std::getline(drive, line)) {
    fprintf(stderr, "cannot read %s or write %s\n", args[1].c_str(), args[2].c_str());
    return 1;
  }
  rclcpp::NodeOptions options;
  options.arguments({"ekf_filter_node"});
  options.parameter_overrides({rclcpp::Parameter("use_sim_time", true)});
  auto node = std::make_shared<RosEkf>(options);
  const auto clock = node->get_clock();
  const auto set_time = [&clock](int64_t ns) {
      if (rcl_set_ros_time_override(clock->get_clock_handle(), ns) != RCL_RET_OK) {
        throw std::runtime_error("the time cannot be set");
      }
    };
  const int64_t begin = std::stoll(line);
  set_time(begin);
  node->initialize();
  const int64_t period = std::llround(1e9 / node->get_parameter("frequency").as_double());
  const auto odometry_pose = pose_of(*node, "odom0"), odometry_twist = twist_of(*node, "odom0");
  const auto fix = pose_of(*node, "pose0");
  std::unique_ptr<CallbackData> imu_pose, imu_twist, imu_acceleration;
  if (node->has_parameter("imu0_config")) {
    imu_pose = std::make_unique<CallbackData>(pose_of(*node, "imu0"));
    imu_twist = std::make_unique<CallbackData>(twist_of(*node, "imu0"));
    imu_acceleration = std::make_unique<CallbackData>(
      "imu0_acceleration", std::vector<bool>(robot_localization::STATE_SIZE, false), 0, false, false, false, 1e9);
  }
  double used = 0.0;
  const auto timed = [&used](const auto & call) {
      const double start = cpu_time();
      call();
      used += cpu_time() - start;
    };
  const auto tick = [&](int64_t now) {
      set_time(now);
      timed([&node]() {node->periodicUpdate();});
      nav_msgs::msg::Odometry found;
      if (!node->getFilteredOdometryMessage(&found)) {
        return;
      }
      const auto & pose = found.pose.pose;
      const auto & q = pose.orientation;
      const double yaw = std::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
      const auto & P = found.pose.covariance;
      fprintf(
        estimates, "%ld,%.12g,%.12g,%.12g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n",
        static_cast<long>(rclcpp::Time(found.header.stamp).nanoseconds()), pose.position.x, pose.position.y, yaw,
        P[0], P[1], P[5], P[7], P[11], P[35]);
    };
  int64_t next = begin + period;
  do {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream fields(line);
    int64_t arrival, stamp;
    std::string kind;
    fields >> arrival >> kind >> stamp;
    for (; next < arrival; next += period) {
      tick(next);
    }
    set_time(arrival);
    if (kind == "odom") {
      auto message = std::make_shared<nav_msgs::msg::Odometry>();
      message->header.frame_id = "odom";
      message->child_frame_id = "base_link";
      message->header.stamp = stamp_of(stamp);
      message->pose.pose.orientation.w = 1.0;
      auto & twist = message->twist;
      auto & C = twist.covariance;
      fields >> twist.twist.linear.x >> twist.twist.angular.z >> C[0] >> C[5] >> C[35] >> C[7];
      C[30] = C[5];
      timed([&]() {node->odometryCallback(message, "odom0", odometry_pose, odometry_twist);});
    } else if (kind == "pose") {
      auto message = std::make_shared<geometry_msgs::msg::PoseWithCovarianceStamped>();
      message->header.frame_id = "map";
      message->header.stamp = stamp_of(stamp);
      double yaw;
      auto & pose = message->pose;
      fields >> pose.pose.position.x >> pose.pose.position.y >> yaw >> pose.covariance[0] >> pose.covariance[7] >>
        pose.covariance[35];
      pose.pose.orientation.z = std::sin(0.5 * yaw);
      pose.pose.orientation.w = std::cos(0.5 * yaw);
      timed([&]() {node->poseCallback(message, fix, "map", "base_link", false);});
    } else if (kind == "imu" && imu_twist) {
      auto message = std::make_shared<sensor_msgs::msg::Imu>();
      message->header.frame_id = "base_link";
      message->header.stamp = stamp_of(stamp);
      message->orientation_covariance[0] = -1.0;  // none, says sensor_msgs/Imu
      fields >> message->angular_velocity.z >> message->angular_velocity_covariance[8];
      timed([&]() {node->imuCallback(message, "imu0", *imu_pose, *imu_twist, *imu_acceleration);});
    }
    if (!fields) {
      fprintf(stderr, "%s: cannot read: %s\n", args[1].c_str(), line.c_str());
      return 1;
    }
  } while (std::getline(drive, line));
  tick(next);
  if (fclose(estimates) != 0) {
    fprintf(stderr, "cannot write %s\n", args[2].c_str());
    return 1;
  }
  fprintf(stderr, "%s %.6f\n", ROBOT_LOCALIZATION_VERSION, used);
  node.reset();
  rclcpp::shutdown();
  return 0;
}
