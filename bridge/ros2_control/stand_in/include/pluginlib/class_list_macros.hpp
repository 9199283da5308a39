// A stand-in of pluginlib: see stand_in/README.md. It checks what the real macro needs: a class that is created without arguments.
#ifndef MOTORD_STAND_IN_CLASS_LIST_MACROS_HPP
#define MOTORD_STAND_IN_CLASS_LIST_MACROS_HPP

#include <type_traits>

#define PLUGINLIB_EXPORT_CLASS(class_type, base_class_type)                                                                    \
    static_assert(std::is_base_of_v<base_class_type, class_type> && std::is_default_constructible_v<class_type>,               \
                  "no plug-in of this base class");

#endif
