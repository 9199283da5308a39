/// @file
/// The client library of motord for C++17 and later, on top of motord.h. Header only; link libmotord. Arrays are also `std::span` where the
/// program is compiled as C++20.
///
/// An object frees its resources; a claim that ends releases its group, and the daemon damps an active one. Failures are exceptions with the
/// sentences of the daemon. For a loop that may not throw, every call has a `try_` variant that returns a motord_status.
///
/// An object belongs to the process that created it. In a forked process its calls throw Forked, except emergency stops, and its end does
/// nothing.

#ifndef MOTORD_HPP
#define MOTORD_HPP

#if !defined(__cplusplus) || __cplusplus < 201703L
#error "motord.hpp needs C++17: compile with -std=c++17 or later, or include motord.h, which works in C and in each C++"
#endif
#if !defined(__cpp_exceptions)
#error "motord.hpp reports failures by exceptions: compile without -fno-exceptions, or include motord.h, whose functions return a motord_status"
#endif

#include "motord.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#if defined(__has_include)
#if __has_include(<version>)
#include <version>
#endif
#endif
#if defined(__cpp_lib_span)
#include <span>
#endif

namespace motord {

/// A duration.
using Nanoseconds = std::chrono::nanoseconds;

/// A call failed. `what()` says what to do.
class Error : public std::runtime_error {
public:
    /// A failure with its sentence.
    Error(motord_status status, const char *message) : std::runtime_error(message), status_(status) {}

    /// The kind of the failure.
    motord_status status() const noexcept { return status_; }

private:
    motord_status status_;
};

/// The group is stopped: it needs a person and a reset.
class Stopped : public Error {
    using Error::Error;
};

/// The daemon refused a request.
class Refused : public Error {
    using Error::Error;
};

/// Another daemon runs now: claim again.
class Restarted : public Error {
    using Error::Error;
};

/// No daemon runs, or it publishes no states. Calls work again once one does.
class NotRunning : public Error {
    using Error::Error;
};

/// The claim no longer owns its group: claim again.
class ClaimLost : public Error {
    using Error::Error;
};

/// This process was forked from the one that created the object: connect again.
class Forked : public Error {
    using Error::Error;
};

/// An emergency stop was confirmed, but motors do not answer and may still move: cut the power.
class MotorsOffline : public Error {
public:
    /// A failure with the joints of these motors.
    MotorsOffline(motord_status status, const char *message, std::vector<std::string> joints)
        : Error(status, message), joints_(std::move(joints)) {}

    /// The joints whose motors do not answer.
    const std::vector<std::string> &joints() const noexcept { return joints_; }

private:
    std::vector<std::string> joints_;
};

namespace detail {

/// The joints of the last failure of this thread.
inline std::vector<std::string> joints() {
    std::vector<std::string> joints;
    while (const char *joint = motord_error_joint(joints.size()))
        joints.emplace_back(joint);
    return joints;
}

inline void check(motord_status status) {
    if (status == MOTORD_STATUS_OK)
        return;
    const char *message = motord_error_message();
    switch (status) {
    case MOTORD_STATUS_STOPPED: throw Stopped(status, message);
    case MOTORD_STATUS_REFUSED: throw Refused(status, message);
    case MOTORD_STATUS_RESTARTED: throw Restarted(status, message);
    case MOTORD_STATUS_NOT_RUNNING: throw NotRunning(status, message);
    case MOTORD_STATUS_CLAIM_LOST: throw ClaimLost(status, message);
    case MOTORD_STATUS_FORKED: throw Forked(status, message);
    case MOTORD_STATUS_MOTORS_OFFLINE: throw MotorsOffline(status, message, joints());
    default: throw Error(status, message);
    }
}

/// The names of the bits of a set.
inline std::vector<std::string> names(std::uint32_t set, const char *(*name_of)(std::uint32_t)) {
    std::vector<std::string> names;
    for (std::uint32_t bit = 1; bit != 0; bit <<= 1) {
        const char *name = (set & bit) != 0 ? name_of(bit) : nullptr;
        if (name)
            names.emplace_back(name);
    }
    return names;
}

/// The name of a joint; empty for an index of none.
inline std::string name_of(motord_client *client, std::size_t joint) {
    const char *name = motord_name(client, MOTORD_LIST_JOINTS, joint);
    return name ? name : "";
}

inline std::uint64_t nanoseconds(Nanoseconds time) noexcept {
    return time.count() > 0 ? static_cast<std::uint64_t>(time.count()) : 0;
}

template <void (*Free)(motord_client *)> struct FreeClient {
    void operator()(motord_client *client) const noexcept { Free(client); }
};
template <void (*Free)(motord_state *)> struct FreeState {
    void operator()(motord_state *state) const noexcept { Free(state); }
};
template <void (*Free)(motord_imu_publisher *)> struct FreePublisher {
    void operator()(motord_imu_publisher *publisher) const noexcept { Free(publisher); }
};
template <void (*Free)(motord_claim *)> struct FreeClaim {
    void operator()(motord_claim *claim) const noexcept { Free(claim); }
};

} // namespace detail

/// The name of a mode, such as `active`.
inline std::string_view name(motord_mode mode) noexcept {
    const char *name = motord_mode_name(mode);
    return name ? name : "unknown";
}

/// The names of the faults that a motor reports.
inline std::vector<std::string> faults(const motord_joint &joint) { return detail::names(joint.faults, motord_fault_name); }

/// The names of the limits that changed the applied command of a joint.
inline std::vector<std::string> limits(const motord_joint &joint) { return detail::names(joint.limits, motord_limit_name); }

class Claim;

/// The daemon's state after a cycle. One thread uses it at a time.
class State {
public:
    /// An empty state. Throws an Error while as many exist as the library permits.
    State() : handle_(motord_state_new()) {
        if (!handle_)
            detail::check(MOTORD_STATUS_UNAVAILABLE);
    }

    /// The cycle of the state.
    motord_cycle cycle() const {
        motord_cycle cycle{};
        detail::check(motord_state_cycle(get(), &cycle));
        return cycle;
    }

    /// Reads a quantity of every joint of `claim`, in its order; NaN while it is unknown. Does not allocate.
    motord_status try_read(const Claim &claim, motord_quantity quantity, double *values, std::size_t count) const noexcept;
    /// As `read`, with a status instead of exceptions.
    motord_status try_read(const Claim &claim, motord_quantity quantity, float *values, std::size_t count) const noexcept;

    /// Reads a quantity into `values`, whose size becomes the number of joints.
    void read(const Claim &claim, motord_quantity quantity, std::vector<double> &values) const;

#if defined(__cpp_lib_span)
    /// Reads a quantity into `values`, which has a number for each joint of `claim`. Does not allocate while it succeeds. C++20.
    void read(const Claim &claim, motord_quantity quantity, std::span<double> values) const {
        detail::check(try_read(claim, quantity, values));
    }
    /// As above, in single precision. C++20.
    void read(const Claim &claim, motord_quantity quantity, std::span<float> values) const {
        detail::check(try_read(claim, quantity, values));
    }
    /// As `read`, with a status instead of exceptions. C++20.
    motord_status try_read(const Claim &claim, motord_quantity quantity, std::span<double> values) const noexcept {
        return try_read(claim, quantity, values.data(), values.size());
    }
    /// As `read`, with a status instead of exceptions. C++20.
    motord_status try_read(const Claim &claim, motord_quantity quantity, std::span<float> values) const noexcept {
        return try_read(claim, quantity, values.data(), values.size());
    }
#endif

    /// The group of `claim`.
    motord_group group(const Claim &claim) const;

    /// The joint with this index in the robot: Client::joint and Claim::joints return it.
    motord_joint joint(std::size_t index) const {
        motord_joint joint{};
        detail::check(try_joint(index, joint));
        return joint;
    }
    /// As `joint`, with a status instead of exceptions.
    motord_status try_joint(std::size_t index, motord_joint &joint) const noexcept {
        return motord_state_joint(get(), index, &joint);
    }

    /// The IMU with this index.
    motord_imu imu(std::size_t index) const {
        motord_imu imu{};
        detail::check(motord_state_imu(get(), index, &imu));
        return imu;
    }

    /// The handle for the functions of motord.h; null after a move. It stays with this object.
    motord_state *get() const noexcept { return handle_.get(); }

private:
    std::unique_ptr<motord_state, detail::FreeState<motord_state_free>> handle_;
};

/// A connection to a daemon. Threads may share it; only one of the waiting threads gets each state.
class Client {
public:
    /// Connects to the daemon of an instance.
    explicit Client(const std::string &instance = "robot") {
        motord_client *client = nullptr;
        detail::check(motord_connect(instance.c_str(), &client));
        handle_.reset(client);
    }

    /// Connects to the daemon of an instance in another runtime directory.
    Client(const std::string &runtime, const std::string &instance) {
        motord_client *client = nullptr;
        detail::check(motord_connect_in(runtime.c_str(), instance.c_str(), &client));
        handle_.reset(client);
    }

    /// Cycles per second of the daemon.
    double rate_hz() const noexcept { return motord_rate_hz(get()); }

    /// The names of joints, groups or IMUs, as they were at the connection.
    std::vector<std::string> names(motord_list list) const {
        std::vector<std::string> names;
        for (std::size_t index = 0; index < motord_count(get(), list); ++index)
            names.emplace_back(motord_name(get(), list, index));
        return names;
    }

    /// The index of a name.
    std::size_t find(motord_list list, const std::string &name) const {
        std::size_t index = 0;
        detail::check(motord_find(get(), list, name.c_str(), &index));
        return index;
    }

    /// The index of a joint.
    std::size_t joint(const std::string &name) const { return find(MOTORD_LIST_JOINTS, name); }

    /// The index of an IMU.
    std::size_t imu(const std::string &name) const { return find(MOTORD_LIST_IMUS, name); }

    /// The limits of the setpoints of a joint.
    motord_joint_limits limits(std::size_t joint) const {
        motord_joint_limits limits{};
        detail::check(motord_limits(get(), joint, &limits));
        return limits;
    }

    /// Sleeps until a new state arrives, and stores it.
    void wait(State &state, Nanoseconds timeout = std::chrono::seconds(1)) const { detail::check(try_wait(state, timeout)); }
    /// As `wait`, with a status instead of exceptions.
    motord_status try_wait(State &state, Nanoseconds timeout) const noexcept {
        return motord_wait(get(), detail::nanoseconds(timeout), state.get());
    }

    /// Sleeps until the state of a cycle whose number is a multiple of `cycles` arrives, or of a later cycle when that one was missed or
    /// this thread woke too late for it: State::cycle returns its number. The next call waits for the next multiple. The first call
    /// returns the next state.
    void wait_cycles(State &state, std::uint32_t cycles, Nanoseconds timeout = std::chrono::seconds(1)) const {
        detail::check(try_wait_cycles(state, cycles, timeout));
    }
    /// As `wait_cycles`, with a status instead of exceptions.
    motord_status try_wait_cycles(State &state, std::uint32_t cycles, Nanoseconds timeout) const noexcept {
        return motord_wait_cycles(get(), cycles, detail::nanoseconds(timeout), state.get());
    }

    /// Waits without a sleep: faster, and uses a processor whole.
    void spin(State &state, Nanoseconds timeout = std::chrono::seconds(1)) const { detail::check(try_spin(state, timeout)); }
    /// As `spin`, with a status instead of exceptions.
    motord_status try_spin(State &state, Nanoseconds timeout) const noexcept {
        return motord_spin(get(), detail::nanoseconds(timeout), state.get());
    }

    /// Damps and stops every motor. No exception means that each motor answered after the stop; otherwise motors may still move, so cut
    /// the power. MotorsOffline names the silent ones.
    void emergency_stop() const { detail::check(try_emergency_stop()); }
    /// As `emergency_stop`, with a status instead of exceptions.
    motord_status try_emergency_stop() const noexcept { return motord_client_emergency_stop(get()); }

    /// Damps and stops every motor, from a signal handler too: async-signal-safe, sets no message. At most 0.2 s. MOTORD_STATUS_OK means
    /// that the daemon sent the commands; otherwise motors may still move, so cut the power. It cannot know whether each motor received
    /// them: emergency_stop, after the handler, names those that do not answer.
    motord_status emergency_stop_signal_safe() const noexcept { return motord_emergency_stop_signal_safe(get()); }

    /// Stores the newest state if this client has not returned it before, and returns whether there is one. Does not wait.
    bool newest(State &state) const {
        bool is_new = false;
        detail::check(try_newest(state, is_new));
        return is_new;
    }
    /// As `newest`, with a status instead of exceptions.
    motord_status try_newest(State &state, bool &is_new) const noexcept { return motord_newest(get(), state.get(), &is_new); }

    /// A file descriptor that becomes readable with each state, for an event loop. The client closes it. Read states with `newest`.
    int file_descriptor() const {
        int descriptor = -1;
        detail::check(motord_file_descriptor(get(), &descriptor));
        return descriptor;
    }

    /// The handle for the functions of motord.h; null after a move. It stays with this object.
    motord_client *get() const noexcept { return handle_.get(); }

private:
    std::unique_ptr<motord_client, detail::FreeClient<motord_client_free>> handle_;
};

/// Publishes the samples of an external IMU. One thread uses it at a time. It survives a restart of the daemon.
class ImuPublisher {
public:
    /// Begins to publish the samples of an external IMU. Takes milliseconds.
    ImuPublisher(const Client &client, const std::string &name) {
        motord_imu_publisher *publisher = nullptr;
        detail::check(motord_imu_publisher_new(client.get(), name.c_str(), &publisher));
        handle_.reset(publisher);
    }

    /// Sends a sample. Does not wait.
    void send(const motord_imu_sample &sample) { detail::check(try_send(sample)); }
    /// As `send`, with a status instead of exceptions.
    motord_status try_send(const motord_imu_sample &sample) noexcept { return motord_imu_publisher_send(get(), &sample); }

    /// The daemon used a sample of this publisher last.
    bool is_used() const noexcept { return motord_imu_publisher_is_used(get()); }

    /// The handle for the functions of motord.h; null after a move. It stays with this object.
    motord_imu_publisher *get() const noexcept { return handle_.get(); }

private:
    std::unique_ptr<motord_imu_publisher, detail::FreePublisher<motord_imu_publisher_free>> handle_;
};

/// Damps and stops every motor of an instance, from any thread, over a connection of its own. Throws as Client::emergency_stop.
inline void emergency_stop(const std::string &instance) { detail::check(motord_emergency_stop(instance.c_str())); }

/// The setpoints of a group, in the order of its claim. A missing array is 0 for every joint; a position needs kp, a velocity kd.
struct Setpoints {
    const double *position = nullptr; ///< rad
    const double *velocity = nullptr; ///< rad/s
    const double *kp = nullptr;       ///< N·m/rad
    const double *kd = nullptr;       ///< N·m·s/rad
    const double *torque = nullptr;   ///< N·m
};

#if defined(__cpp_lib_span)
/// As Setpoints, with the size of each array, which is that of the claim. An empty one is 0 for every joint. `Number` is double or float.
/// C++20.
template <typename Number> struct BasicSetpointSpans {
    std::span<const Number> position = {}; ///< rad
    std::span<const Number> velocity = {}; ///< rad/s
    std::span<const Number> kp = {};       ///< N·m/rad
    std::span<const Number> kd = {};       ///< N·m·s/rad
    std::span<const Number> torque = {};   ///< N·m
};

/// The setpoints of a group in double precision. C++20.
using SetpointSpans = BasicSetpointSpans<double>;
/// The setpoints of a group in single precision. C++20.
using SetpointSpansF32 = BasicSetpointSpans<float>;

namespace detail {

/// The size of the arrays; that of one which differs from `count`, if one does.
template <typename Number> std::size_t size_of(const BasicSetpointSpans<Number> &setpoints, std::size_t count) noexcept {
    for (std::span<const Number> values :
         {setpoints.position, setpoints.velocity, setpoints.kp, setpoints.kd, setpoints.torque})
        if (!values.empty() && values.size() != count)
            return values.size();
    return count;
}

} // namespace detail
#endif

/// The ownership of a group. One thread uses it at a time. Its end releases the group; an active group is stopped.
class Claim {
public:
    /// Claims a group: Refused while another process owns it. Takes milliseconds.
    Claim(const Client &client, const std::string &group) {
        motord_claim *claim = nullptr;
        detail::check(motord_claim_group(client.get(), group.c_str(), &claim));
        handle_.reset(claim);
    }

    /// Number of joints.
    std::size_t size() const noexcept { return motord_claim_count(get()); }

    /// The indices in the robot of the joints, in the order of the claim.
    std::vector<std::size_t> joints() const {
        std::vector<std::size_t> joints(size());
        detail::check(motord_claim_joints(get(), joints.size(), joints.data()));
        return joints;
    }

    /// The index in the arrays of this claim of each of `names`, in their order: `position[indices[0]]` is that of `names[0]`. For a
    /// controller whose joints have another order, such as that of a URDF, of Pinocchio, or of a policy. `client` is that of the claim.
    /// Throws an Error that names the joint, and those of the claim, unless `names` has each joint of the claim once. Call it before the
    /// loop: it allocates.
    std::vector<std::size_t> indices(const Client &client, const std::vector<std::string> &names) const;

    /// Stores the setpoints that hold the positions in `state`. Send them with `commit`.
    void hold(const State &state, double kp, double kd) { detail::check(motord_hold(get(), state.get(), kp, kd)); }

    /// Sets the horizon of the setpoints that are sent from now on: the daemon moves to each within this time after it was sent.
    /// For a controller slower than the cycle. At most `setpoint-horizon-max-ms` of the configuration; zero: at once.
    void set_horizon(Nanoseconds horizon) { detail::check(try_set_horizon(horizon)); }
    /// As `set_horizon`, with a status instead of exceptions.
    motord_status try_set_horizon(Nanoseconds horizon) noexcept {
        return motord_set_horizon(get(), detail::nanoseconds(horizon));
    }

    /// Sends the stored setpoints again. Throws Stopped with each call after a stop of the group
    /// that this claim had started, until a reset.
    void commit() { detail::check(try_commit()); }
    /// As `commit`, with a status instead of exceptions.
    motord_status try_commit() noexcept { return motord_commit(get()); }

    /// Sends a setpoint for each joint. Each array has `count` numbers. Does not wait. Throws as `commit`.
    void send(const Setpoints &setpoints, std::size_t count) { detail::check(try_send(setpoints, count)); }
    /// As `send`, with a status instead of exceptions.
    motord_status try_send(const Setpoints &setpoints, std::size_t count) noexcept {
        return motord_send(get(), count, setpoints.position, setpoints.velocity, setpoints.kp, setpoints.kd, setpoints.torque);
    }

#if defined(__cpp_lib_span)
    /// Sends a setpoint for each joint. Does not wait. Throws as `commit`, and an Error where an array has another size than the claim:
    /// then nothing is sent. C++20.
    void send(const SetpointSpans &setpoints) { detail::check(try_send(setpoints)); }
    /// As above, in single precision. C++20.
    void send(const SetpointSpansF32 &setpoints) { detail::check(try_send(setpoints)); }
    /// As `send`, with a status instead of exceptions. C++20.
    motord_status try_send(const SetpointSpans &setpoints) noexcept {
        // A size that differs is refused before an array is read.
        return motord_send(get(), detail::size_of(setpoints, size()), data(setpoints.position), data(setpoints.velocity),
                           data(setpoints.kp), data(setpoints.kd), data(setpoints.torque));
    }
    /// As `send`, with a status instead of exceptions. C++20.
    motord_status try_send(const SetpointSpansF32 &setpoints) noexcept {
        return motord_send_f32(get(), detail::size_of(setpoints, size()), data(setpoints.position), data(setpoints.velocity),
                               data(setpoints.kp), data(setpoints.kd), data(setpoints.torque));
    }
#endif

    /// Starts the motors towards the last setpoints sent.
    void enable() { detail::check(motord_enable(get())); }

    /// Sleeps until the group is in `phase` or past it. Once it is active, the daemon keeps the last setpoints for
    /// `setpoint-horizon-max-ms` and the setpoint timeout: send the next ones before.
    void wait_for(motord_phase phase, Nanoseconds timeout = std::chrono::seconds(5)) {
        detail::check(motord_wait_for(get(), phase, detail::nanoseconds(timeout)));
    }

    /// Fails when the group does not follow its setpoints: call it after each wait.
    void must_be_active(const State &state) const { detail::check(try_must_be_active(state)); }
    /// As `must_be_active`, with a status instead of exceptions.
    motord_status try_must_be_active(const State &state) const noexcept { return motord_must_be_active(state.get(), get()); }

    /// Damps and stops the motors.
    void disable() { detail::check(motord_disable(get())); }

    /// Clears the latched cause of a stop. A controller should leave this to a person who has inspected the robot.
    void reset() { detail::check(motord_reset(get())); }

    /// Releases the group, and fails where the daemon does not confirm it.
    void release() { detail::check(motord_release(get())); }

    /// The handle for the functions of motord.h; null after a move. It stays with this object.
    motord_claim *get() const noexcept { return handle_.get(); }

private:
#if defined(__cpp_lib_span)
    /// Null for an empty array, which may have an address.
    template <typename Number> static const Number *data(std::span<const Number> values) noexcept {
        return values.empty() ? nullptr : values.data();
    }
#endif

    std::unique_ptr<motord_claim, detail::FreeClaim<motord_claim_free>> handle_;
};

inline motord_status State::try_read(const Claim &claim, motord_quantity quantity, double *values,
                                     std::size_t count) const noexcept {
    return motord_read(get(), claim.get(), quantity, count, values);
}

inline motord_status State::try_read(const Claim &claim, motord_quantity quantity, float *values,
                                     std::size_t count) const noexcept {
    return motord_read_f32(get(), claim.get(), quantity, count, values);
}

inline void State::read(const Claim &claim, motord_quantity quantity, std::vector<double> &values) const {
    values.resize(claim.size());
    detail::check(try_read(claim, quantity, values.data(), values.size()));
}

inline std::vector<std::size_t> Claim::indices(const Client &client, const std::vector<std::string> &names) const {
    std::vector<std::string> known;
    for (std::size_t joint : joints())
        known.push_back(detail::name_of(client.get(), joint));
    const auto fail = [&known](motord_status status, std::string sentence) {
        for (std::size_t index = 0; index < known.size(); ++index)
            sentence += (index == 0 ? "; the claim has " : ", ") + known[index];
        throw Error(status, sentence.c_str());
    };
    std::vector<std::size_t> indices;
    std::vector<bool> is_named(known.size(), false);
    for (const std::string &name : names) {
        const std::size_t index = static_cast<std::size_t>(std::find(known.begin(), known.end(), name) - known.begin());
        if (index == known.size())
            fail(MOTORD_STATUS_UNKNOWN, "there is no joint \"" + name + "\"");
        if (is_named[index])
            fail(MOTORD_STATUS_BAD_ARGUMENT, "names has " + name + " twice");
        is_named[index] = true;
        indices.push_back(index);
    }
    for (std::size_t index = 0; index < known.size(); ++index)
        if (!is_named[index])
            fail(MOTORD_STATUS_BAD_ARGUMENT, "names lacks " + known[index] + ": name each joint of the claim");
    return indices;
}

inline motord_group State::group(const Claim &claim) const {
    motord_group group{};
    detail::check(motord_state_group(get(), claim.get(), &group));
    return group;
}

} // namespace motord

#endif // MOTORD_HPP
