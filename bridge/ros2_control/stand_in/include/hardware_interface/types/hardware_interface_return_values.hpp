// A stand-in of hardware_interface: see stand_in/README.md.
#ifndef MOTORD_STAND_IN_HARDWARE_INTERFACE_RETURN_VALUES_HPP
#define MOTORD_STAND_IN_HARDWARE_INTERFACE_RETURN_VALUES_HPP

#include <cstdint>

namespace hardware_interface {

enum class return_type : std::uint8_t { OK = 0, ERROR = 1, DEACTIVATE = 2 };

} // namespace hardware_interface

#endif
