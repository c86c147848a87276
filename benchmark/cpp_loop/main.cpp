// Copyright 2026 The manip_sim developers
// SPDX-License-Identifier: Apache-2.0

// The plain loop of targets/plain_loop.py in C++: a yardstick without Python.
//
// usage: cpp_loop MODEL EVERY REALTIME

#include <mujoco/mujoco.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "geometry_msgs/msg/wrench_stamped.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/joint_state.hpp"

using geometry_msgs::msg::WrenchStamped;
using sensor_msgs::msg::JointState;

// Steps a model and publishes joint states and a wrench.
class CppLoop : public rclcpp::Node
{
public:
  explicit CppLoop(const std::string & path)
  : Node("cpp_loop")
  {
    char error[1000] = "";
    const std::string stem = path.substr(0, path.rfind('.'));
    const bool is_xml = path == stem + ".xml";
    model = is_xml ? mj_loadXML(path.c_str(), nullptr, error, sizeof error) :
      mj_loadModel(path.c_str(), nullptr);
    if (!model) {
      throw std::runtime_error(path + " is no model: " + error);
    }
    data = mj_makeData(model);
    if (!is_xml) {
      std::vector<mjtNum> state(mj_stateSize(model, mjSTATE_INTEGRATION));
      std::ifstream file(stem + ".state", std::ios::binary);
      if (!file.read(reinterpret_cast<char *>(state.data()), state.size() * sizeof(mjtNum))) {
        throw std::runtime_error(stem + ".state has no state of the model");
      }
      mj_setState(model, data, state.data(), mjSTATE_INTEGRATION);
    }
    for (int joint = 0; joint < model->njnt; ++joint) {
      message.name.push_back(model->names + model->name_jntadr[joint]);
    }
    for (auto values : {&message.position, &message.velocity, &message.effort}) {
      values->resize(model->njnt);
    }
    for (int actuator = 0; actuator < model->nu; ++actuator) {
      actuators[message.name[model->actuator_trnid[2 * actuator]]] = actuator;
    }
    controls.assign(data->ctrl, data->ctrl + model->nu);
    wrench.header.frame_id = "right_hand";
    force = sensor("force_ee");
    torque = sensor("torque_ee");
    states = create_publisher<JointState>("joint_states", 10);
    wrenches = create_publisher<WrenchStamped>("right/wrench", 10);
    commands = create_subscription<JointState>(
      "arm/joint_command", 10, [this](const JointState & command) {
        std::lock_guard<std::mutex> lock(mutex);
        for (size_t n = 0; n < std::min(command.name.size(), command.effort.size()); ++n) {
          controls.at(actuators.at(command.name[n])) = command.effort[n];
        }
      });
  }

  void run(int every, bool realtime)
  {
    using Clock = std::chrono::steady_clock;
    const auto period = std::chrono::duration_cast<Clock::duration>(
      std::chrono::duration<double>(every * model->opt.timestep));
    for (auto deadline = Clock::now(); rclcpp::ok(); ) {
      {
        std::lock_guard<std::mutex> lock(mutex);
        mju_copy(data->ctrl, controls.data(), model->nu);
      }
      for (int step = 0; step < every; ++step) {
        mj_step(model, data);
      }
      publish();
      if (realtime) {
        deadline += period;
        std::this_thread::sleep_until(deadline);
        if (Clock::now() - deadline > std::chrono::milliseconds(100)) {
          deadline = Clock::now();
        }
      }
    }
  }

private:
  const mjtNum * sensor(const std::string & end) const
  {
    for (int n = 0; n < model->nsensor; ++n) {
      const std::string name = model->names + model->name_sensoradr[n];
      if (name.size() >= end.size() && !name.compare(name.size() - end.size(), end.size(), end)) {
        return data->sensordata + model->sensor_adr[n];
      }
    }
    throw std::runtime_error("no sensor whose name ends with " + end);
  }

  void publish()
  {
    message.header.stamp.sec = static_cast<int>(data->time);
    message.header.stamp.nanosec = (data->time - message.header.stamp.sec) * 1e9;
    for (int joint = 0; joint < model->njnt; ++joint) {
      message.position[joint] = data->qpos[model->jnt_qposadr[joint]];
      message.velocity[joint] = data->qvel[model->jnt_dofadr[joint]];
      message.effort[joint] = data->qfrc_actuator[model->jnt_dofadr[joint]];
    }
    states->publish(message);
    wrench.header.stamp = message.header.stamp;
    auto & f = wrench.wrench.force;
    auto & t = wrench.wrench.torque;
    f.x = force[0], f.y = force[1], f.z = force[2];
    t.x = torque[0], t.y = torque[1], t.z = torque[2];
    wrenches->publish(wrench);
  }

  mjModel * model;
  mjData * data;
  const mjtNum * force, * torque;
  std::map<std::string, int> actuators;
  std::mutex mutex;
  std::vector<mjtNum> controls;
  JointState message;
  WrenchStamped wrench;
  rclcpp::Publisher<JointState>::SharedPtr states;
  rclcpp::Publisher<WrenchStamped>::SharedPtr wrenches;
  rclcpp::Subscription<JointState>::SharedPtr commands;
};

int main(int argc, char ** argv)
{
  if (argc != 4) {
    std::cerr << "usage: cpp_loop MODEL EVERY REALTIME" << std::endl;
    return 2;
  }
  rclcpp::init(argc, argv);
  const auto loop = std::make_shared<CppLoop>(argv[1]);
  std::thread spinner([loop]() {rclcpp::spin(loop);});
  loop->run(std::atoi(argv[2]), argv[3] == std::string("1"));
  spinner.join();
  rclcpp::shutdown();
  return 0;
}
