// A stand-in of hardware_interface: see stand_in/README.md. Interfaces are those of the HardwareInfo, NaN until they are set;
// an unknown one throws, as in ros2_control.
#ifndef MOTORD_STAND_IN_SYSTEM_INTERFACE_HPP
#define MOTORD_STAND_IN_SYSTEM_INTERFACE_HPP

#include <limits>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/types/hardware_component_interface_params.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/node_interfaces/lifecycle_node_interface.hpp"

namespace hardware_interface {

using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

class HardwareComponentInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface {
public:
    HardwareComponentInterface() = default;
    HardwareComponentInterface(const HardwareComponentInterface &) = delete;
    HardwareComponentInterface(HardwareComponentInterface &&) = delete;

    virtual CallbackReturn on_init(const HardwareComponentInterfaceParams &params) {
        info_ = params.hardware_info;
        for (const auto *components : {&info_.joints, &info_.sensors})
            for (const auto &component : *components) {
                for (const auto &each : component.state_interfaces)
                    states_[component.name + "/" + each.name] = std::numeric_limits<double>::quiet_NaN();
                for (const auto &each : component.command_interfaces)
                    commands_[component.name + "/" + each.name] = std::numeric_limits<double>::quiet_NaN();
            }
        return CallbackReturn::SUCCESS;
    }
    virtual return_type prepare_command_mode_switch(const std::vector<std::string> &, const std::vector<std::string> &) {
        return return_type::OK;
    }
    virtual return_type perform_command_mode_switch(const std::vector<std::string> &, const std::vector<std::string> &) {
        return return_type::OK;
    }
    virtual return_type read(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;
    virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) { return return_type::OK; }

    template <typename T> void set_state(const std::string &name, const T &value) { find(states_, name) = value; }
    template <typename T = double> T get_state(const std::string &name) const { return find(states_, name); }
    template <typename T> void set_command(const std::string &name, const T &value) { find(commands_, name) = value; }
    template <typename T = double> T get_command(const std::string &name) const { return find(commands_, name); }

    virtual rclcpp::Logger get_logger() const { return rclcpp::Logger("resource_manager.hardware_component." + info_.name); }
    const HardwareInfo &get_hardware_info() const { return info_; }

protected:
    HardwareInfo info_;

private:
    template <typename Values> static auto &find(Values &values, const std::string &name) {
        const auto found = values.find(name);
        if (found == values.end())
            throw std::runtime_error("The requested interface not found: " + name);
        return found->second;
    }

    std::unordered_map<std::string, double> states_, commands_;
};

class SystemInterface : public HardwareComponentInterface {
public:
    return_type write(const rclcpp::Time &time, const rclcpp::Duration &period) override = 0;
};

} // namespace hardware_interface

#endif
