// A stand-in of rclcpp: see stand_in/README.md.
#ifndef MOTORD_STAND_IN_RCLCPP_HPP
#define MOTORD_STAND_IN_RCLCPP_HPP

#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>

namespace rclcpp {

class Time {
public:
    explicit Time(std::int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
    std::int64_t nanoseconds() const { return nanoseconds_; }

private:
    std::int64_t nanoseconds_;
};

class Duration {
public:
    Duration(std::int32_t seconds, std::uint32_t nanoseconds) : nanoseconds_(seconds * 1000000000LL + nanoseconds) {}
    std::int64_t nanoseconds() const { return nanoseconds_; }

private:
    std::int64_t nanoseconds_;
};

class Logger {
public:
    explicit Logger(std::string name) : name_(std::move(name)) {}
    const char *get_name() const { return name_.c_str(); }

private:
    std::string name_;
};

class Executor {
public:
    using WeakPtr = std::weak_ptr<Executor>;
};

} // namespace rclcpp

#define RCLCPP_ERROR(logger, ...)                                                                                             \
    do {                                                                                                                      \
        std::fprintf(stderr, "[ERROR] [%s]: ", (logger).get_name());                                                           \
        std::fprintf(stderr, __VA_ARGS__);                                                                                     \
        std::fputc('\n', stderr);                                                                                              \
    } while (false)

#endif
