// Copyright 2026 The manip_sim developers
// SPDX-License-Identifier: Apache-2.0

// The hardware component of ros2_control for the robot of a manip_sim node. It reads and writes
// topics, and owns the order of time between the control loop and the physics:
//
// - A cycle of the loop reads the state of the instant that the clock shows, and its command
//   bears the stamp of that state, so that lock-step takes it as the answer.
// - What the loop does not answer (states before its first cycle, between two of its cycles, and
//   while the component is inactive) is answered here with "go on as before".
// - Controllers that claim other interfaces change the control mode of the part.
// - After a reset, a command counts when it changes; what held the robot before does not.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "geometry_msgs/msg/wrench_stamped.hpp"
#include "hardware_interface/system_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/imu.hpp"
#include "sensor_msgs/msg/joint_state.hpp"

namespace manip_sim_hardware
{
namespace
{
using geometry_msgs::msg::WrenchStamped;
using hardware_interface::CallbackReturn;
using hardware_interface::return_type;
using sensor_msgs::msg::Imu;
using sensor_msgs::msg::JointState;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr auto kServiceTimeout = std::chrono::seconds(5);
constexpr auto kAnswerTimeout = std::chrono::seconds(2);
constexpr int kTimesAsked = 5;
constexpr int kStatesUntilAskedAgain = 50;
//! A joint that moves farther between two states than twice its speed allows was put there [rad, m].
constexpr double kJump = 1e-3;

std::int64_t nanoseconds(const builtin_interfaces::msg::Time & stamp)
{
  return std::int64_t{stamp.sec} * 1'000'000'000 + stamp.nanosec;
}

bool same(double a, double b) {return a == b || (std::isnan(a) && std::isnan(b));}

//! Stamps are rounded to nanoseconds; control periods are longer than this.
constexpr std::int64_t kRoundingNs = 10'000;

//! The last instant, up to a given one, at which a sensor measures; a rate of 0: with each state.
std::int64_t last_measured(std::int64_t stamp_ns, double rate_hz)
{
  if (rate_hz <= 0.0) {return stamp_ns;}
  const double count = std::floor(1e-9 * static_cast<double>(stamp_ns + kRoundingNs) * rate_hz);
  return std::llround(1e9 * count / rate_hz);
}

template<typename Message>
struct Sensor
{
  std::string name;
  double rate_hz;
  typename Message::ConstSharedPtr message;
  typename rclcpp::Subscription<Message>::SharedPtr subscription;

  //! A node that is paused publishes what it holds between two measurements too: not taken here.
  void take(typename Message::ConstSharedPtr newer)
  {
    const std::int64_t stamp_ns = nanoseconds(newer->header.stamp);
    if (!message || stamp_ns - last_measured(stamp_ns, rate_hz) <= kRoundingNs) {
      message = std::move(newer);
    }
  }

  //! Whether what belongs to the state of an instant has come; a silent sensor is not waited for.
  bool has_measured(std::int64_t stamp_ns) const
  {
    return !message ||
           nanoseconds(message->header.stamp) + kRoundingNs >= last_measured(stamp_ns, rate_hz);
  }
};
}  // namespace

/**
 * The component. Parameters of the tag:
 *
 * - joint_states_topic, joint_commands_topic: of the node
 * - node: whose parameters select control modes (/manip_sim)
 * - lockstep: whether the physics waits for commands (false)
 * - state_timeout: how long a cycle waits for its state, wall time [s] (1.0; lockstep: 10.0)
 *
 * of a joint: mode_parameter, such as control_mode.arm, if its mode can change; of a sensor: topic, and
 * rate if it measures less often than states come [Hz].
 */
class ManipSimSystem : public hardware_interface::SystemInterface
{
public:
  ~ManipSimSystem() override
  {
    ended_ = true;
    if (spinner_.joinable()) {spinner_.join();}
  }

  CallbackReturn on_init(
    const hardware_interface::HardwareComponentInterfaceParams & params) override
  {
    if (SystemInterface::on_init(params) != CallbackReturn::SUCCESS) {return CallbackReturn::ERROR;}
    const auto & info = get_hardware_info();
    try {
      lockstep_ = parameter("lockstep", "false") == "true";
      state_timeout_ = std::chrono::duration<double>(
        std::stod(parameter("state_timeout", lockstep_ ? "10.0" : "1.0")));
      // A node and a thread of its own: states come while the control loop waits for them.
      node_ = std::make_shared<rclcpp::Node>(
        "manip_sim_hardware", rclcpp::NodeOptions().use_global_arguments(false));
      modes_client_ = std::make_shared<rclcpp::AsyncParametersClient>(
        node_, parameter("node", "/manip_sim"));
      publisher_ = node_->create_publisher<JointState>(
        parameter("joint_commands_topic", "/robot_joint_commands"), rclcpp::QoS(10));
      for (const auto & joint : info.joints) {
        if (joint.command_interfaces.empty()) {continue;}
        Joint driven{joint.name, {}, ""};
        for (const auto & command : joint.command_interfaces) {
          if (!is_field(command.name)) {
            throw std::invalid_argument(
                    joint.name + ": unknown command interface '" + command.name + "'");
          }
          driven.commands.push_back({joint.name + "/" + command.name, command.name});
        }
        const auto mode = joint.parameters.find("mode_parameter");
        if (mode != joint.parameters.end()) {driven.mode_parameter = mode->second;}
        joints_.push_back(driven);
      }
      for (const auto & sensor : info.sensors) {subscribe(sensor);}
    } catch (const std::exception & error) {
      RCLCPP_FATAL(get_logger(), "%s", error.what());
      return CallbackReturn::ERROR;
    }
    const unsigned int rate = std::max(1u, info.rw_rate);
    period_ns_ = 1'000'000'000 / rate;
    subscription_ = node_->create_subscription<JointState>(
      parameter("joint_states_topic", "/robot_joint_states"), rclcpp::QoS(10),
      [this](JointState::ConstSharedPtr message) {take_state(std::move(message));});
    spinner_ = std::thread([this] {
          rclcpp::executors::SingleThreadedExecutor executor;
          executor.add_node(node_);
          while (rclcpp::ok() && !ended_) {executor.spin_once(std::chrono::milliseconds(100));}
        });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    std::lock_guard<std::mutex> lock(mutex_);
    looping_ = in_a_cycle_ = false;
    return CallbackReturn::SUCCESS;
  }

  return_type prepare_command_mode_switch(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) override
  {
    std::lock_guard<std::mutex> lock(mutex_);
    try {
      modes_of(claims_after(start, stop));
    } catch (const std::invalid_argument & error) {
      RCLCPP_ERROR(get_logger(), "%s", error.what());
      return return_type::ERROR;
    }
    return return_type::OK;
  }

  return_type perform_command_mode_switch(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) override
  {
    // Another thread may run the control loop meanwhile: nothing is commanded until the node has
    // changed the mode.
    std::map<std::string, std::string> wanted;
    {
      std::lock_guard<std::mutex> lock(mutex_);
      claims_ = claims_after({}, stop);
      for (const auto & [name, mode] : modes_of(claims_after(start, {}))) {
        const auto known = modes_.find(name);
        if (known == modes_.end() || known->second != mode) {wanted[name] = mode;}
      }
      if (!wanted.empty() && answer_) {answer_ = nothing(answer_->header.stamp);}
    }
    for (const auto & [name, mode] : wanted) {
      if (!set_mode(name, mode)) {return return_type::ERROR;}
    }
    std::lock_guard<std::mutex> lock(mutex_);
    claims_ = claims_after(start, {});
    for (const auto & key : start) {held_.erase(key);}
    return return_type::OK;
  }

  return_type read(const rclcpp::Time & time, const rclcpp::Duration &) override
  {
    std::unique_lock<std::mutex> lock(mutex_);
    const std::int64_t now = time.nanoseconds();
    if (lockstep_ || get_clock()->ros_time_is_active()) {
      looping_ = in_a_cycle_ = true;
      next_cycle_ns_ = now + period_ns_;
      const bool came = arrived_.wait_for(lock, state_timeout_, [this, now] {return complete(now);});
      if (!came) {
        RCLCPP_WARN_THROTTLE(
          get_logger(), *node_->get_clock(), 1000,
          "%s of %.6f s has not come; the last state is of %.6f s", missing(now).c_str(),
          now * 1e-9, stamp_ns_ * 1e-9);
      }
    }
    if (!state_) {return return_type::OK;}
    read_ = state_;
    notice_reset();
    for (std::size_t i = 0; i < read_->name.size(); ++i) {
      const auto & name = read_->name[i];
      put(name + "/position", read_->position[i]);
      put(name + "/velocity", read_->velocity[i]);
      put(name + "/effort", read_->effort[i]);
    }
    for (const auto & sensor : wrenches_) {
      if (sensor.message) {
        put(sensor.name, "force", sensor.message->wrench.force);
        put(sensor.name, "torque", sensor.message->wrench.torque);
      }
    }
    for (const auto & sensor : imus_) {
      if (sensor.message) {
        put(sensor.name, "orientation", sensor.message->orientation);
        put(sensor.name + "/orientation.w", sensor.message->orientation.w);
        put(sensor.name, "angular_velocity", sensor.message->angular_velocity);
        put(sensor.name, "linear_acceleration", sensor.message->linear_acceleration);
      }
    }
    return return_type::OK;
  }

  return_type write(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!read_) {return return_type::OK;}
    in_a_cycle_ = false;
    // The loop may begin with a state that was answered already.
    if (lockstep_ && answer_ && answer_->header.stamp == read_->header.stamp) {
      return return_type::OK;
    }
    JointState message = nothing(read_->header.stamp);
    bool any = false;
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      for (const auto & command : joints_[i].commands) {
        if (std::find(claims_.begin(), claims_.end(), command.key) == claims_.end()) {continue;}
        const double value = get_command<double>(command.key);
        const auto held = held_.find(command.key);
        if (held != held_.end()) {
          if (same(held->second, value)) {continue;}
          held_.erase(held);
        }
        field(message, command.interface)[i] = value;
        any = any || !std::isnan(value);
      }
    }
    // Without lock-step nobody waits for a message without a number.
    if (any || lockstep_) {
      publisher_->publish(message);
      answer_ = std::move(message);
    }
    return return_type::OK;
  }

private:
  struct Command
  {
    std::string key, interface;
  };

  struct Joint
  {
    std::string name;
    std::vector<Command> commands;
    std::string mode_parameter;
  };

  static bool is_field(const std::string & name)
  {
    return name == "position" || name == "velocity" || name == "effort";
  }

  static std::vector<double> & field(JointState & message, const std::string & interface)
  {
    return interface == "position" ? message.position :
           interface == "velocity" ? message.velocity : message.effort;
  }

  std::string parameter(const std::string & name, const std::string & otherwise)
  {
    const auto & given = get_hardware_info().hardware_parameters;
    const auto found = given.find(name);
    return found == given.end() ? otherwise : found->second;
  }

  void subscribe(const hardware_interface::ComponentInfo & sensor)
  {
    const auto topic = sensor.parameters.find("topic");
    if (topic == sensor.parameters.end()) {
      throw std::invalid_argument("sensor '" + sensor.name + "' has no parameter 'topic'");
    }
    const auto rate = sensor.parameters.find("rate");
    const double rate_hz = rate == sensor.parameters.end() ? 0.0 : std::stod(rate->second);
    const bool is_wrench = std::any_of(
      sensor.state_interfaces.begin(), sensor.state_interfaces.end(),
      [](const auto & state) {return state.name.rfind("force.", 0) == 0;});
    if (is_wrench) {
      subscribe(wrenches_, sensor.name, topic->second, rate_hz);
    } else {
      subscribe(imus_, sensor.name, topic->second, rate_hz);
    }
  }

  template<typename Message>
  void subscribe(
    std::deque<Sensor<Message>> & sensors, const std::string & name, const std::string & topic,
    double rate_hz)
  {
    auto & sensor = sensors.emplace_back(Sensor<Message>{name, rate_hz, nullptr, nullptr});
    sensor.subscription = node_->create_subscription<Message>(
      topic, rclcpp::QoS(10), [this, &sensor](typename Message::ConstSharedPtr message) {
        std::lock_guard<std::mutex> lock(mutex_);
        sensor.take(std::move(message));
        arrived_.notify_all();
      });
  }

  //! Tell whether the state of an instant has come, and the measurements that belong to it.
  bool complete(std::int64_t now) const
  {
    if (!state_ || stamp_ns_ < now) {return false;}
    const auto has_come = [this](const auto & sensor) {return sensor.has_measured(stamp_ns_);};
    return std::all_of(wrenches_.begin(), wrenches_.end(), has_come) &&
           std::all_of(imus_.begin(), imus_.end(), has_come);
  }

  //! Name what a cycle waits for.
  std::string missing(std::int64_t now) const
  {
    if (!state_ || stamp_ns_ < now) {return "the state";}
    for (const auto & sensor : wrenches_) {
      if (!sensor.has_measured(stamp_ns_)) {return sensor.name;}
    }
    for (const auto & sensor : imus_) {
      if (!sensor.has_measured(stamp_ns_)) {return sensor.name;}
    }
    return "the state";
  }

  void take_state(JointState::ConstSharedPtr message)
  {
    std::lock_guard<std::mutex> lock(mutex_);
    const std::int64_t stamp_ns = nanoseconds(message->header.stamp);
    if (state_ && stamp_ns < stamp_ns_) {restarted();}
    state_ = std::move(message);
    stamp_ns_ = stamp_ns;
    arrived_.notify_all();
    if (modes_are_lost_ && modes_client_->service_is_ready()) {ask_for_modes();}
    if (lockstep_ && publisher_->get_subscription_count() > 0) {answer_for_the_loop();}
  }

  //! Ask until there is an answer: the service that is ready may be that of the node that ended.
  void ask_for_modes()
  {
    if (states_since_asked_++ % kStatesUntilAskedAgain != 0) {return;}
    std::vector<rclcpp::Parameter> parameters;
    for (const auto & [name, mode] : modes_) {parameters.emplace_back(name, mode);}
    if (parameters.empty()) {
      modes_are_lost_ = false;
      return;
    }
    modes_client_->set_parameters(
      parameters, [this](auto) {
        std::lock_guard<std::mutex> lock(mutex_);
        modes_are_lost_ = false;
      });
  }

  //! Answer the newest state, unless the control loop does.
  void answer_for_the_loop()
  {
    const bool of_the_next_cycle = looping_ && stamp_ns_ >= next_cycle_ns_;
    const bool of_this_cycle = in_a_cycle_ && stamp_ns_ + period_ns_ >= next_cycle_ns_;
    if (of_the_next_cycle || of_this_cycle) {return;}
    // A state comes again if its answer was lost, came late, or came when the mode changed.
    if (!answer_ || nanoseconds(answer_->header.stamp) != stamp_ns_) {
      answer_ = nothing(state_->header.stamp);
    }
    publisher_->publish(*answer_);
  }

  //! Simulated time has begun again: let it pass until the control loop, which sleeps, goes on.
  void restarted()
  {
    RCLCPP_WARN(get_logger(), "simulated time has begun again");
    looping_ = false;
    in_a_cycle_ = false;
    answer_.reset();
    read_.reset();
    for (auto & sensor : wrenches_) {sensor.message.reset();}
    for (auto & sensor : imus_) {sensor.message.reset();}
    hold_commands();
    modes_are_lost_ = true;
    states_since_asked_ = 0;
  }

  //! What controllers command at this moment counts only when it changes.
  void hold_commands()
  {
    for (const auto & key : claims_) {
      if (has_command(key)) {held_[key] = get_command<double>(key);}
    }
  }

  void notice_reset()
  {
    const double elapsed_s = (nanoseconds(read_->header.stamp) - before_ns_) * 1e-9;
    bool jumped = false;
    for (std::size_t i = 0; i < read_->name.size(); ++i) {
      auto & [position, velocity] = before_[read_->name[i]];
      const double speed = std::max(std::abs(velocity), std::abs(read_->velocity[i]));
      jumped = jumped || (before_ns_ != 0 && elapsed_s > 0.0 &&
        std::abs(read_->position[i] - position) > kJump + 2.0 * speed * elapsed_s);
      position = read_->position[i];
      velocity = read_->velocity[i];
    }
    before_ns_ = nanoseconds(read_->header.stamp);
    if (jumped) {
      RCLCPP_WARN(get_logger(), "the robot was reset: commands count again when they change");
      hold_commands();
    }
  }

  //! Return a command that names all driven joints and has no number.
  JointState nothing(const builtin_interfaces::msg::Time & stamp) const
  {
    JointState message;
    message.header.stamp = stamp;
    for (const auto & joint : joints_) {message.name.push_back(joint.name);}
    message.position.assign(joints_.size(), kNone);
    message.velocity.assign(joints_.size(), kNone);
    message.effort.assign(joints_.size(), kNone);
    return message;
  }

  std::vector<std::string> claims_after(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) const
  {
    std::vector<std::string> claims;
    for (const auto & key : claims_) {
      if (std::find(stop.begin(), stop.end(), key) == stop.end()) {claims.push_back(key);}
    }
    for (const auto & key : start) {
      const bool ours = std::any_of(
        joints_.begin(), joints_.end(), [&key](const Joint & joint) {
          return std::any_of(
            joint.commands.begin(), joint.commands.end(),
            [&key](const Command & command) {return command.key == key;});
        });
      if (ours && std::find(claims.begin(), claims.end(), key) == claims.end()) {
        claims.push_back(key);
      }
    }
    return claims;
  }

  /**
   * Return the control modes that claimed interfaces mean, by the parameter of the part.
   *
   * Throws std::invalid_argument if the joints of a part would be in different modes.
   */
  std::map<std::string, std::string> modes_of(const std::vector<std::string> & claims) const
  {
    std::map<std::string, std::string> modes;
    for (const auto & joint : joints_) {
      std::string claimed;
      for (const auto & command : joint.commands) {
        if (std::find(claims.begin(), claims.end(), command.key) == claims.end()) {continue;}
        if (!claimed.empty()) {
          throw std::invalid_argument(
                  joint.name + ": claimed are " + claimed + " and " + command.interface);
        }
        claimed = command.interface;
      }
      if (claimed.empty() || joint.mode_parameter.empty()) {continue;}
      const auto [entry, is_new] = modes.emplace(joint.mode_parameter, claimed);
      if (!is_new && entry->second != claimed) {
        throw std::invalid_argument(
                joint.name + ": claimed is " + claimed + ", but " + joint.mode_parameter +
                " is one for all joints of the part: " + entry->second);
      }
    }
    return modes;
  }

  bool set_mode(const std::string & name, const std::string & mode)
  {
    if (!modes_client_->wait_for_service(kServiceTimeout)) {
      RCLCPP_ERROR(get_logger(), "%s: the node does not answer", name.c_str());
      return false;
    }
    // DDS may lose an answer, and the service may still be that of a node that has ended.
    for (int asked = 0; asked < kTimesAsked; ++asked) {
      auto results = modes_client_->set_parameters({rclcpp::Parameter(name, mode)});
      if (results.wait_for(kAnswerTimeout) != std::future_status::ready) {
        RCLCPP_WARN(get_logger(), "%s := %s: no answer yet", name.c_str(), mode.c_str());
        continue;
      }
      const auto result = results.get().front();
      if (!result.successful) {
        RCLCPP_ERROR(
          get_logger(), "%s := %s: %s", name.c_str(), mode.c_str(), result.reason.c_str());
        return false;
      }
      std::lock_guard<std::mutex> lock(mutex_);
      modes_[name] = mode;
      return true;
    }
    RCLCPP_ERROR(
      get_logger(), "%s := %s: no answer to %d requests", name.c_str(), mode.c_str(), kTimesAsked);
    return false;
  }

  void put(const std::string & key, double value)
  {
    if (has_state(key)) {set_state(key, value);}
  }

  template<typename Vector>
  void put(const std::string & name, const std::string & kind, const Vector & vector)
  {
    put(name + "/" + kind + ".x", vector.x);
    put(name + "/" + kind + ".y", vector.y);
    put(name + "/" + kind + ".z", vector.z);
  }

  bool lockstep_ = false;
  std::chrono::duration<double> state_timeout_{1.0};
  std::int64_t period_ns_ = 10'000'000;
  std::vector<Joint> joints_;
  rclcpp::Node::SharedPtr node_;
  rclcpp::AsyncParametersClient::SharedPtr modes_client_;
  rclcpp::Publisher<JointState>::SharedPtr publisher_;
  rclcpp::Subscription<JointState>::SharedPtr subscription_;
  std::thread spinner_;
  std::atomic<bool> ended_{false};

  // What both threads use; mutex_ guards it.
  std::mutex mutex_;
  std::condition_variable arrived_;
  JointState::ConstSharedPtr state_;
  std::int64_t stamp_ns_ = 0;
  //! The last message that was sent.
  std::optional<JointState> answer_;
  std::deque<Sensor<WrenchStamped>> wrenches_;
  std::deque<Sensor<Imu>> imus_;
  bool looping_ = false;
  bool in_a_cycle_ = false;
  std::int64_t next_cycle_ns_ = 0;
  std::vector<std::string> claims_;
  std::map<std::string, std::string> modes_;
  bool modes_are_lost_ = false;
  int states_since_asked_ = 0;
  std::map<std::string, double> held_;

  // What the control loop read last.
  JointState::ConstSharedPtr read_;
  std::int64_t before_ns_ = 0;
  std::unordered_map<std::string, std::pair<double, double>> before_;
};
}  // namespace manip_sim_hardware

PLUGINLIB_EXPORT_CLASS(manip_sim_hardware::ManipSimSystem, hardware_interface::SystemInterface)
