// A stand-in of hardware_interface: see stand_in/README.md.
#ifndef MOTORD_STAND_IN_HARDWARE_INFO_HPP
#define MOTORD_STAND_IN_HARDWARE_INFO_HPP

#include <string>
#include <unordered_map>
#include <vector>

namespace hardware_interface {

struct InterfaceInfo {
    std::string name;
    std::string min, max, initial_value;
    std::string data_type = "double";
    int size = 0;
    std::unordered_map<std::string, std::string> parameters;
    bool enable_limits = false;
};

struct ComponentInfo {
    std::string name;
    std::string type;
    std::vector<InterfaceInfo> command_interfaces;
    std::vector<InterfaceInfo> state_interfaces;
    std::unordered_map<std::string, std::string> parameters;
};

struct HardwareInfo {
    std::string name;
    std::string type;
    std::string hardware_plugin_name;
    std::unordered_map<std::string, std::string> hardware_parameters;
    std::vector<ComponentInfo> joints;
    std::vector<ComponentInfo> sensors;
    std::vector<ComponentInfo> gpios;
};

} // namespace hardware_interface

#endif
