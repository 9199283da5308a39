/** @file
 * The client library of motord for C. C++ programs include motord.hpp.
 *
 * A program connects, claims a group of joints, and sends a setpoint for each joint in every cycle. If it stops sending, or dies, the
 * daemon damps the group. Every function that can fail returns a motord_status; motord_error_message() explains the failure.
 *
 * Several threads may use a client; one at a time a state and a claim: a second one gets MOTORD_STATUS_BUSY. Free nothing that another
 * thread is using.
 *
 * A motord_client, motord_state, motord_claim or motord_imu_publisher pointer is a number, no address: the library never follows it, and
 * gives it to no other object. A call with a null pointer, a freed one or one of another kind returns MOTORD_STATUS_BAD_ARGUMENT, and a
 * function that frees ignores it.
 *
 * The numbers are those of one copy of the library. In a process with two copies, such as a static and a shared one, objects of both
 * may have the same number: use an object only with the copy that created it, and link one copy where that is possible.
 *
 * Clients, states, claims and publishers belong to the process that created them. In a forked process each call with one returns
 * MOTORD_STATUS_FORKED, or the value of an object that is none, and a function that frees does nothing. Only the two emergency stops of
 * a client work there too. The check makes no system call. It does not detect a child that shares the memory, one of vfork or of clone
 * with CLONE_VM: such a child may only call execve or _exit.
 *
 * After the first cycles `motord_wait`, `motord_wait_cycles`, `motord_spin`, `motord_newest`, `motord_read`, `motord_state_group`,
 * `motord_state_joint`, `motord_state_imu`, `motord_must_be_active`, `motord_send` and `motord_commit` allocate nothing while they
 * succeed, wait for no other thread, and log nothing: a real-time thread may call them. A failure allocates its message. All other
 * functions may allocate.
 * Functions that change a claim or ask the daemon wait for its answer, a cycle or two, at most a second.
 * Only `motord_emergency_stop_signal_safe` may be called from a signal handler.
 *
 * Units are SI, joint side. docs/cpp.md is the guide.
 */

#ifndef MOTORD_H
#define MOTORD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/**
 * The result of a function. `motord_error_message` explains a failure.
 */
typedef enum motord_status {
  /**
   * It succeeded.
   */
  MOTORD_STATUS_OK = 0,
  /**
   * No state arrived in time, or the phase was not reached.
   */
  MOTORD_STATUS_TIMEOUT = 1,
  /**
   * No daemon runs, or it publishes no states. Calls work again once one does.
   */
  MOTORD_STATUS_NOT_RUNNING = 2,
  /**
   * Another daemon runs now: claim again.
   */
  MOTORD_STATUS_RESTARTED = 3,
  /**
   * The daemon refused the request.
   */
  MOTORD_STATUS_REFUSED = 4,
  /**
   * The group is stopped. It needs a person and a reset.
   */
  MOTORD_STATUS_STOPPED = 5,
  /**
   * The claim no longer owns its group: claim again.
   */
  MOTORD_STATUS_CLAIM_LOST = 6,
  /**
   * There is no joint, group or IMU of this name or index.
   */
  MOTORD_STATUS_UNKNOWN = 7,
  /**
   * An argument is a null pointer, a freed handle, a wrong number of values, or no text in UTF-8.
   */
  MOTORD_STATUS_BAD_ARGUMENT = 8,
  /**
   * A value is not finite, a gain is negative, or a horizon is longer than the configuration permits.
   */
  MOTORD_STATUS_BAD_SETPOINT = 9,
  /**
   * A motor has not reported its position.
   */
  MOTORD_STATUS_NOT_HEARD = 10,
  /**
   * The user lacks the permission.
   */
  MOTORD_STATUS_PERMISSION = 11,
  /**
   * Library and daemon have different versions.
   */
  MOTORD_STATUS_VERSION = 12,
  /**
   * The daemon did not confirm a request. It may have executed it. After an emergency stop: cut the power.
   */
  MOTORD_STATUS_NOT_CONFIRMED = 13,
  /**
   * A service is damaged, or every slot of it is taken.
   */
  MOTORD_STATUS_UNAVAILABLE = 14,
  /**
   * Another thread uses this claim, state or publisher.
   */
  MOTORD_STATUS_BUSY = 15,
  /**
   * A defect of this library.
   */
  MOTORD_STATUS_DEFECT = 16,
  /**
   * This process was forked from the one that created the object: connect again.
   */
  MOTORD_STATUS_FORKED = 17,
  /**
   * An emergency stop was confirmed, but motors do not answer and may still move: cut the power. `motord_error_joint` names them.
   */
  MOTORD_STATUS_MOTORS_OFFLINE = 18,
  /**
   * An emergency stop was confirmed, but whether each motor answers was not checked: watch the robot.
   */
  MOTORD_STATUS_MOTORS_UNCHECKED = 19,
} motord_status;

/**
 * Phase of a group.
 */
typedef enum motord_phase {
  /**
   * Every motor is stopped.
   */
  MOTORD_PHASE_DISARMED = 0,
  /**
   * The motors are being started.
   */
  MOTORD_PHASE_STARTING = 1,
  /**
   * The group follows setpoints.
   */
  MOTORD_PHASE_ACTIVE = 2,
  /**
   * The group is being damped and will be stopped.
   */
  MOTORD_PHASE_DAMPING = 3,
  /**
   * This library does not know the phase.
   */
  MOTORD_PHASE_UNKNOWN = 4,
} motord_phase;

/**
 * Mode of a motor.
 */
typedef enum motord_mode {
  /**
   * The motor has not answered, or stopped answering.
   */
  MOTORD_MODE_OFFLINE = 0,
  /**
   * The motor answers and is stopped.
   */
  MOTORD_MODE_IDLE = 1,
  /**
   * The motor receives neutral commands and is being started.
   */
  MOTORD_MODE_STARTING = 2,
  /**
   * The motor follows setpoints.
   */
  MOTORD_MODE_ACTIVE = 3,
  /**
   * The motor is being damped; it will be stopped.
   */
  MOTORD_MODE_DAMPING = 4,
  /**
   * The motor reported a fault; it is stopped until the fault is cleared.
   */
  MOTORD_MODE_FAULT = 5,
  /**
   * The joint is excluded: its motor gets stop frames only, and its group runs without it.
   */
  MOTORD_MODE_EXCLUDED = 6,
  /**
   * This library does not know the mode.
   */
  MOTORD_MODE_UNKNOWN = 7,
} motord_mode;

/**
 * A quantity of a joint.
 */
typedef enum motord_quantity {
  /**
   * Position, rad.
   */
  MOTORD_QUANTITY_POSITION = 0,
  /**
   * Velocity, rad/s.
   */
  MOTORD_QUANTITY_VELOCITY = 1,
  /**
   * Torque, N·m.
   */
  MOTORD_QUANTITY_TORQUE = 2,
  /**
   * Temperature of the motor, °C.
   */
  MOTORD_QUANTITY_TEMPERATURE = 3,
  /**
   * Position of the applied command, rad.
   */
  MOTORD_QUANTITY_APPLIED_POSITION = 4,
  /**
   * Velocity of the applied command, rad/s.
   */
  MOTORD_QUANTITY_APPLIED_VELOCITY = 5,
  /**
   * Torque of the applied command, N·m.
   */
  MOTORD_QUANTITY_APPLIED_TORQUE = 6,
  /**
   * Stiffness of the applied command, N·m/rad.
   */
  MOTORD_QUANTITY_APPLIED_KP = 7,
  /**
   * Damping of the applied command, N·m·s/rad.
   */
  MOTORD_QUANTITY_APPLIED_KD = 8,
  /**
   * Time from the motor's last reply to now, s; NaN before its first.
   */
  MOTORD_QUANTITY_AGE = 9,
  /**
   * Voltage of the supply as the motor last reported it, V.
   */
  MOTORD_QUANTITY_SUPPLY_VOLTAGE = 10,
  /**
   * Current from the supply as the motor last reported it, A.
   */
  MOTORD_QUANTITY_SUPPLY_CURRENT = 11,
} motord_quantity;

/**
 * The lists of names of a robot.
 */
typedef enum motord_list {
  /**
   * Joints.
   */
  MOTORD_LIST_JOINTS = 0,
  /**
   * Groups of joints.
   */
  MOTORD_LIST_GROUPS = 1,
  /**
   * IMUs.
   */
  MOTORD_LIST_IMUS = 2,
} motord_list;

/**
 * A fault that a motor reports: a bit of `faults` of a `motord_joint`.
 */
typedef enum motord_fault {
  /**
   * The current loop could not keep its rate (FOC frequency too high).
   */
  MOTORD_FAULT_FOC_FREQUENCY = (1 << 0),
  /**
   * The bus voltage is above the driver's threshold.
   */
  MOTORD_FAULT_OVER_VOLTAGE = (1 << 1),
  /**
   * The bus voltage is below the driver's threshold.
   */
  MOTORD_FAULT_UNDER_VOLTAGE = (1 << 2),
  /**
   * The motor or its driver is hotter than the driver's threshold.
   */
  MOTORD_FAULT_OVER_TEMPERATURE = (1 << 3),
  /**
   * The motor could not be started.
   */
  MOTORD_FAULT_START_FAILURE = (1 << 4),
  /**
   * The current was above what the driver allows.
   */
  MOTORD_FAULT_OVER_CURRENT = (1 << 6),
  /**
   * The driver's software met a condition it could not handle (software exception).
   */
  MOTORD_FAULT_SOFTWARE = (1 << 7),
  /**
   * The driver's transistors are hotter than its threshold.
   */
  MOTORD_FAULT_DRIVER_OVER_TEMPERATURE = (1 << 8),
  /**
   * The motor's winding is hotter than the driver's threshold.
   */
  MOTORD_FAULT_MOTOR_OVER_TEMPERATURE = (1 << 9),
  /**
   * The driver received no command for longer than its timeout.
   */
  MOTORD_FAULT_HOST_SILENT = (1 << 10),
  /**
   * The motor was overloaded or stalled for too long.
   */
  MOTORD_FAULT_OVERLOAD = (1 << 11),
  /**
   * The driver's gate driver chip reports a fault.
   */
  MOTORD_FAULT_DRIVER_CHIP = (1 << 12),
  /**
   * The encoder is not calibrated, or does not work.
   */
  MOTORD_FAULT_ENCODER = (1 << 13),
  /**
   * The driver does not recognise its own hardware.
   */
  MOTORD_FAULT_HARDWARE = (1 << 14),
  /**
   * The driver could not find the motor's position at its start.
   */
  MOTORD_FAULT_POSITION = (1 << 15),
  /**
   * The motor reports a fault that is in no document: look at the number in the highest byte.
   */
  MOTORD_FAULT_UNRECOGNISED = (1 << 23),
} motord_fault;

/**
 * A limit that changed a command: a bit of `limits` of a `motord_joint`.
 */
typedef enum motord_limit {
  /**
   * The position was clamped.
   */
  MOTORD_LIMIT_POSITION = (1 << 0),
  /**
   * The velocity was clamped.
   */
  MOTORD_LIMIT_VELOCITY = (1 << 1),
  /**
   * The stiffness was clamped.
   */
  MOTORD_LIMIT_KP = (1 << 2),
  /**
   * The damping was clamped.
   */
  MOTORD_LIMIT_KD = (1 << 3),
  /**
   * The torque was clamped.
   */
  MOTORD_LIMIT_TORQUE = (1 << 4),
  /**
   * The position changed too fast.
   */
  MOTORD_LIMIT_POSITION_SLEW = (1 << 5),
  /**
   * The stiffness changed too fast.
   */
  MOTORD_LIMIT_KP_SLEW = (1 << 6),
  /**
   * The damping changed too fast.
   */
  MOTORD_LIMIT_KD_SLEW = (1 << 7),
  /**
   * The torque changed too fast.
   */
  MOTORD_LIMIT_TORQUE_SLEW = (1 << 8),
  /**
   * Stiffness, damping and torque together asked for too much torque.
   */
  MOTORD_LIMIT_TOTAL_TORQUE = (1 << 9),
  /**
   * The motor is hot: its torque is derated.
   */
  MOTORD_LIMIT_TEMPERATURE = (1 << 10),
  /**
   * The gains are still rising after the start.
   */
  MOTORD_LIMIT_START_RAMP = (1 << 11),
  /**
   * The motor gave more than its rated torque for too long: its torque is derated.
   */
  MOTORD_LIMIT_OVERLOAD = (1 << 12),
} motord_limit;

/**
 * The ownership of a group; empty once it is released. One thread uses it at a time.
 */
typedef struct motord_claim motord_claim;

/**
 * A connection.
 */
typedef struct motord_client motord_client;

/**
 * The publisher of an external IMU. One thread uses it at a time.
 */
typedef struct motord_imu_publisher motord_imu_publisher;

/**
 * A state of the caller; empty before the first. One thread uses it at a time.
 */
typedef struct motord_state motord_state;

/**
 * Limits of the setpoints of a joint.
 */
typedef struct motord_joint_limits {
  /**
   * Lowest position, rad.
   */
  double position_min;
  /**
   * Highest position, rad.
   */
  double position_max;
  /**
   * Largest speed, rad/s.
   */
  double velocity;
  /**
   * Largest torque, N·m.
   */
  double torque;
  /**
   * Largest stiffness, N·m/rad.
   */
  double kp;
  /**
   * Largest damping, N·m·s/rad.
   */
  double kd;
} motord_joint_limits;

/**
 * A measurement of an IMU, in the frame of the sensor: the daemon applies `mount-rpy-deg`.
 */
typedef struct motord_imu_sample {
  /**
   * Orientation of the sensor in the world, whose z points up: a unit quaternion w, x, y, z, within 1 %.
   */
  double orientation[4];
  /**
   * Angular velocity, rad/s.
   */
  double angular_velocity[3];
  /**
   * Specific force, m/s²: at rest 9.81 upwards.
   */
  double acceleration[3];
  /**
   * Temperature of the sensor, °C; NaN for none.
   */
  double temperature;
  /**
   * Time of the measurement, ns of `CLOCK_MONOTONIC`; 0 for now. It must increase, and may not be older than `lost-after-ms`.
   */
  uint64_t time_ns;
} motord_imu_sample;

/**
 * The cycle of a state.
 */
typedef struct motord_cycle {
  /**
   * Number of the cycle, from 1. It counts ticks: missed ticks leave a gap.
   */
  uint64_t cycle;
  /**
   * The tick with the number of the cycle, ns of `CLOCK_MONOTONIC`: periods apart, also after missed ticks.
   */
  uint64_t tick_ns;
  /**
   * Time when the states were complete, ns of `CLOCK_MONOTONIC`.
   */
  uint64_t publish_ns;
  /**
   * Ticks missed since the start of the daemon.
   */
  uint64_t overruns;
  /**
   * The emergency stop is latched.
   */
  bool emergency_stop;
  /**
   * The cycle has real-time scheduling and locked memory.
   */
  bool realtime;
  /**
   * The daemon is shutting down.
   */
  bool shutting_down;
} motord_cycle;

/**
 * A group after a cycle.
 */
typedef struct motord_group {
  /**
   * Its phase.
   */
  enum motord_phase phase;
  /**
   * Its owner is this claim.
   */
  bool owned;
  /**
   * It was stopped and needs a reset.
   */
  bool latched;
  /**
   * The cause of the stop, such as `motor-lost`; null without a stop.
   */
  const char *cause;
  /**
   * The joint that caused the stop, by index in the robot; -1 for none.
   */
  int32_t cause_joint;
  /**
   * Age of the setpoint in use when the cycle began, s; NaN for none.
   */
  double setpoint_age;
  /**
   * Setpoint messages accepted, modulo 2³².
   */
  uint32_t accepted;
  /**
   * Accepted messages that missed the first cycle after the one that they answer, modulo 2³².
   */
  uint32_t late;
} motord_group;

/**
 * A joint after a cycle. A value is NaN while the motor does not report it.
 */
typedef struct motord_joint {
  /**
   * Position, rad.
   */
  double position;
  /**
   * Velocity, rad/s.
   */
  double velocity;
  /**
   * Torque, N·m.
   */
  double torque;
  /**
   * Temperature of the motor, °C.
   */
  double temperature;
  /**
   * Position of the command that the motor got after all limits, rad.
   */
  double applied_position;
  /**
   * Velocity of that command, rad/s.
   */
  double applied_velocity;
  /**
   * Stiffness of that command, N·m/rad.
   */
  double applied_kp;
  /**
   * Damping of that command, N·m·s/rad.
   */
  double applied_kd;
  /**
   * Torque of that command, N·m.
   */
  double applied_torque;
  /**
   * Time from the motor's last reply to now, s; NaN before its first.
   */
  double age;
  /**
   * Age in turns of the motor when the states were published; 0 for a reply to its last command. A turn is a cycle, or N cycles with
   * `every = N`.
   */
  uint32_t age_cycles;
  /**
   * Turns without a reply since the daemon started.
   */
  uint32_t missed;
  /**
   * Replies that arrived after the end of their turn.
   */
  uint32_t late;
  /**
   * Faults that the motor reports: bits of `motord_fault`.
   */
  uint32_t faults;
  /**
   * Limits that changed the applied command: bits of `motord_limit`.
   */
  uint32_t limits;
  /**
   * Mode of the motor.
   */
  enum motord_mode mode;
  /**
   * The motor answered the command of its last turn.
   */
  bool fresh;
  /**
   * The motor differs from its configuration, or has not reported its registers: its group is not enabled. The daemon's log has the
   * difference.
   */
  bool mismatch;
} motord_joint;

/**
 * An IMU after a cycle. Values are NaN before the first sample.
 */
typedef struct motord_imu {
  /**
   * Orientation of the body in the world: a unit quaternion w, x, y, z.
   */
  double orientation[4];
  /**
   * Angular velocity of the body, rad/s.
   */
  double angular_velocity[3];
  /**
   * Specific force on the body, m/s²: at rest 9.81 upwards.
   */
  double acceleration[3];
  /**
   * Direction of gravity in the frame of the body, a unit vector: 0, 0, -1 for a level body.
   */
  double projected_gravity[3];
  /**
   * Temperature of the sensor, °C; NaN where it reports none.
   */
  double temperature;
  /**
   * Time from the receipt of the sample to now, s.
   */
  double age;
  /**
   * Samples received since the daemon started.
   */
  uint64_t sequence;
  /**
   * A sample was received since the previous states were published.
   */
  bool fresh;
  /**
   * No sample for longer than `lost-after-ms`, or the device is disconnected.
   */
  bool lost;
  /**
   * Bits of the conventions in which orientation and acceleration would agree about gravity, while they contradict each other at
   * rest; 0 while they agree: 1 `quaternion-xyzw`, 2 `quaternion-inverse`, 4 `quaternion-ned`, 8 `z-down`, 16 `acceleration-axes`,
   * 32 `acceleration-in-g`, 64 `without-gravity`, 128 `direction`, 256 `size`. `motorctl explain` has their meaning.
   */
  uint32_t contradictions;
} motord_imu;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Claims a group. Free the claim with `motord_claim_free`. The claim ends with its process; in a forked process calls with it return
 * `MOTORD_STATUS_FORKED`.
 *
 * # Safety
 * `client` is a client, `group` a text that ends with a null byte; `claim` leads to a place for a pointer.
 */
enum motord_status motord_claim_group(struct motord_client *client,
                                      const char *group,
                                      struct motord_claim **claim);

/**
 * Frees a claim, and releases its group: an active group is stopped. Null is no error.
 *
 * # Safety
 * `claim` is null, or a claim that is no longer in use.
 */
void motord_claim_free(struct motord_claim *claim);

/**
 * Releases the group of a claim, and reports whether the daemon did it. The claim must still be freed.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_release(struct motord_claim *claim);

/**
 * Returns the number of joints of a claim; 0 for a claim that is none, or was released.
 *
 * # Safety
 * `claim` is a claim.
 */
size_t motord_claim_count(struct motord_claim *claim);

/**
 * Reads the indices in the robot of the joints of a claim, in its order.
 *
 * # Safety
 * `claim` is a claim; `joints` leads to `count` numbers.
 */
enum motord_status motord_claim_joints(struct motord_claim *claim, size_t count, size_t *joints);

/**
 * Stores for each joint the setpoint that holds its position in `state`, with the stiffness `kp`, N·m/rad, and the damping `kd`,
 * N·m·s/rad. Send it with `motord_commit`.
 *
 * # Safety
 * `claim` is a claim, `state` a state.
 */
enum motord_status motord_hold(struct motord_claim *claim,
                               struct motord_state *state,
                               double kp,
                               double kd);

/**
 * Sets the horizon of the setpoints that are sent from now on: the daemon moves position, velocity and torque linearly from the
 * present command to the setpoint within `horizon_ns` after it was sent, inside all limits. 0, the initial value, applies setpoints
 * immediately. The setpoint timeout begins at the end of the horizon. For a controller slower than the cycle.
 * `MOTORD_STATUS_BAD_SETPOINT` when it is longer than `setpoint-horizon-max-ms` of the configuration. Neither allocates nor waits.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_set_horizon(struct motord_claim *claim,
                                      uint64_t horizon_ns);

/**
 * Sends the stored setpoints again. Call it in every cycle of the controller, even if nothing changed. `MOTORD_STATUS_STOPPED` with
 * each call after a stop of the group that this claim had started, until a reset.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_commit(struct motord_claim *claim);

/**
 * Stores and sends a setpoint for each joint of the group, in the order of the claim: position, rad; velocity, rad/s; stiffness,
 * N·m/rad; damping, N·m·s/rad; torque, N·m. A null pointer for an array is 0 for every joint. Does not wait. The motor's torque is
 * `kp · (position - p) + kd · (velocity - v) + torque`, within the limits of the joint. `MOTORD_STATUS_BAD_SETPOINT`: a value is not
 * finite, or a gain is negative; then nothing is stored or sent. `MOTORD_STATUS_BAD_ARGUMENT`: a position without stiffness or a
 * velocity without damping, by which the joints would be limp. `MOTORD_STATUS_STOPPED` with each call after a stop of the group
 * that this claim had started, until a reset.
 *
 * # Safety
 * `claim` is a claim; each array is null or leads to `count` numbers.
 */
enum motord_status motord_send(struct motord_claim *claim,
                               size_t count,
                               const double *position,
                               const double *velocity,
                               const double *kp,
                               const double *kd,
                               const double *torque);

/**
 * As `motord_send`, with numbers of single precision.
 *
 * # Safety
 * As `motord_send`.
 */
enum motord_status motord_send_f32(struct motord_claim *claim,
                                   size_t count,
                                   const float *position,
                                   const float *velocity,
                                   const float *kp,
                                   const float *kd,
                                   const float *torque);

/**
 * Starts the motors of the group towards the last setpoints sent, which must be near the positions of the joints. Continue to
 * send afterwards, or wait with `motord_wait_for`.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_enable(struct motord_claim *claim);

/**
 * Sleeps until the group is in a `motord_phase` or past it, at most `timeout_ns`, and repeats the last setpoints in each cycle. Once
 * the group is active, the daemon keeps them for `setpoint-horizon-max-ms` and the setpoint timeout: send the next ones before.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_wait_for(struct motord_claim *claim,
                                   uint32_t phase,
                                   uint64_t timeout_ns);

/**
 * Damps and stops the motors of the group.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_disable(struct motord_claim *claim);

/**
 * Clears the latched cause of a stop. The group must be disarmed. A controller should leave this to a person who has inspected the
 * robot.
 *
 * # Safety
 * `claim` is a claim.
 */
enum motord_status motord_reset(struct motord_claim *claim);

/**
 * Returns the version of this library, such as `0.1.0`. Never null.
 */
const char *motord_version(void);

/**
 * Returns a sentence about the last failure of this thread, in UTF-8: what failed, and what to do. Empty before the first failure,
 * never null. Valid until the next failure of this thread.
 */
const char *motord_error_message(void);

/**
 * Returns the name of a joint of the last failure of this thread, in UTF-8; null for an index beyond the last. After
 * `MOTORD_STATUS_MOTORS_OFFLINE` these are the joints whose motors do not answer; other failures name none. Valid until the next
 * failure of this thread.
 */
const char *motord_error_joint(size_t index);

/**
 * Connects to the daemon of `instance`. Takes milliseconds. Free the client with `motord_client_free`.
 *
 * # Safety
 * `instance` is a text that ends with a null byte; `client` leads to a place for a pointer.
 */
enum motord_status motord_connect(const char *instance,
                                  struct motord_client **client);

/**
 * Connects to the daemon of `instance` in another runtime directory.
 *
 * # Safety
 * As `motord_connect`.
 */
enum motord_status motord_connect_in(const char *runtime,
                                     const char *instance,
                                     struct motord_client **client);

/**
 * Frees a client. Its claims and publishers stay valid. Null is no error.
 *
 * # Safety
 * `client` is null, or one of `motord_connect` that is no longer in use.
 */
void motord_client_free(struct motord_client *client);

/**
 * Returns the number of names of a `motord_list`; 0 for a client that is no client.
 *
 * # Safety
 * `client` is a client.
 */
size_t motord_count(struct motord_client *client, uint32_t list);

/**
 * Returns a name of a `motord_list` as it was at the connection; null for an index of none. Valid as long as the client.
 *
 * # Safety
 * `client` is a client.
 */
const char *motord_name(struct motord_client *client,
                        uint32_t list,
                        size_t index);

/**
 * Finds the index of a name of a `motord_list`.
 *
 * # Safety
 * `client` is a client, `name` a text that ends with a null byte; `index` leads to a place for a number.
 */
enum motord_status motord_find(struct motord_client *client,
                               uint32_t list,
                               const char *name,
                               size_t *index);

/**
 * Returns the cycles per second of the daemon; NaN for a client that is no client.
 *
 * # Safety
 * `client` is a client.
 */
double motord_rate_hz(struct motord_client *client);

/**
 * Reads the limits of the setpoints of a joint, by its index in the robot.
 *
 * # Safety
 * `client` is a client; `limits` leads to a place for them.
 */
enum motord_status motord_limits(struct motord_client *client,
                                 size_t joint,
                                 struct motord_joint_limits *limits);

/**
 * Damps and stops every motor of `instance`, over a connection of its own. Any thread may call it; no other call delays it.
 * Usually takes some cycles, 0.3 s longer while motors do not answer, and at most little more than two seconds. `MOTORD_STATUS_OK`
 * means that each motor answered after the stop: otherwise motors may still move, so cut the power. After
 * `MOTORD_STATUS_MOTORS_OFFLINE` `motord_error_joint` names the silent ones. It is not async-signal-safe: see
 * `motord_emergency_stop_signal_safe`.
 *
 * # Safety
 * `instance` is a text that ends with a null byte.
 */
enum motord_status motord_emergency_stop(const char *instance);

/**
 * Damps and stops every motor of the robot of a client, as `motord_emergency_stop` does. It works in a forked process too, over a
 * connection of its own.
 *
 * # Safety
 * `client` is a client.
 */
enum motord_status motord_client_emergency_stop(struct motord_client *client);

/**
 * Damps and stops every motor of the robot of a client, from a signal handler too: async-signal-safe. It allocates nothing, takes no
 * lock, keeps `errno`, sets no message, and uses the stack and system calls of signal-safety(7) only. It needs one free file descriptor.
 * Any thread may call it, at any time between `motord_connect` and `motord_client_free`, and so may a forked process; no other call
 * delays it.
 *
 * Usually takes a cycle or two, at most 0.2 s. `MOTORD_STATUS_OK` means that the daemon sent the commands: otherwise motors may still
 * move, so cut the power. It cannot know whether each motor received them: one without power or bus does not answer. Call
 * `motord_client_emergency_stop` after the handler, which names these motors. It sends the request over one path, the daemon's socket for emergency stops; outside of signal handlers
 * `motord_client_emergency_stop` tries a second one.
 *
 * # Safety
 * `client` is a client.
 */
enum motord_status motord_emergency_stop_signal_safe(struct motord_client *client);

/**
 * Returns a file descriptor that becomes readable with each state, for an event loop: `poll`, `epoll`, `select`. Read the state with
 * `motord_newest`. The descriptor belongs to the client, which closes it, and survives a restart of the daemon.
 *
 * The first call takes milliseconds. From then on each call that returns a state makes one or two further system calls, and the
 * daemon makes one in each cycle. The descriptor may be readable without a new state, and an ended daemon leaves it unreadable: use a
 * timeout, after which `motord_wait` returns the reason.
 *
 * # Safety
 * `client` is a client; `descriptor` leads to a place for a number.
 */
enum motord_status motord_file_descriptor(struct motord_client *client,
                                          int *descriptor);

/**
 * Begins to publish the samples of the external IMU `name`. The publisher survives a restart of the daemon. The daemon uses the samples
 * of one publisher; another one may begin when none of them was used for `lost-after-ms`. Free it with `motord_imu_publisher_free`.
 *
 * # Safety
 * `client` is a client, `name` a text that ends with a null byte; `publisher` leads to a place for a pointer.
 */
enum motord_status motord_imu_publisher_new(struct motord_client *client,
                                            const char *name,
                                            struct motord_imu_publisher **publisher);

/**
 * Frees a publisher. Null is no error.
 *
 * # Safety
 * `publisher` is null, or a publisher that is no longer in use.
 */
void motord_imu_publisher_free(struct motord_imu_publisher *publisher);

/**
 * Sends a sample. Does not wait. `MOTORD_STATUS_BAD_SETPOINT`: a value is not finite, the orientation is no unit quaternion, or
 * the time is of another clock. `MOTORD_STATUS_REFUSED`: the daemon uses the samples of another process.
 * `MOTORD_STATUS_NOT_RUNNING`: without a daemon; later samples arrive once one runs again.
 *
 * # Safety
 * `publisher` is a publisher, `sample` a sample.
 */
enum motord_status motord_imu_publisher_send(struct motord_imu_publisher *publisher,
                                             const struct motord_imu_sample *sample);

/**
 * Returns true if the daemon used a sample of this publisher last, by the newest state.
 *
 * # Safety
 * `publisher` is a publisher.
 */
bool motord_imu_publisher_is_used(struct motord_imu_publisher *publisher);

/**
 * Creates an empty state. Free it with `motord_state_free`. Null while 65 536 states exist, which `motord_error_message` says. In a
 * 32-bit program: while 256 exist, and once 2²⁵ were created.
 */
struct motord_state *motord_state_new(void);

/**
 * Frees a state. Null is no error.
 *
 * # Safety
 * `state` is null, or a state that is no longer in use.
 */
void motord_state_free(struct motord_state *state);

/**
 * Sleeps until a state arrives that this client has not returned before, at most `timeout_ns`, and stores it.
 *
 * After `MOTORD_STATUS_RESTARTED` connect again if the configuration may have changed, and claim again.
 *
 * # Safety
 * `client` is a client, `state` a state.
 */
enum motord_status motord_wait(struct motord_client *client,
                               uint64_t timeout_ns,
                               struct motord_state *state);

/**
 * Sleeps as `motord_wait`, until the state of a cycle whose number is a multiple of `cycles` arrives. Stores the state of a later cycle
 * when that one was missed by the daemon, or when a still newer one arrived before this thread ran: `motord_state_cycle` returns its
 * number. The next call waits for the next multiple. The first call stores the next state. For a controller that runs at an integer
 * part of the daemon's rate; `timeout_ns` must be longer than `cycles` cycles.
 *
 * # Safety
 * As `motord_wait`.
 */
enum motord_status motord_wait_cycles(struct motord_client *client,
                                      uint32_t cycles,
                                      uint64_t timeout_ns,
                                      struct motord_state *state);

/**
 * Waits as `motord_wait` without a sleep: faster, and uses a processor whole.
 *
 * # Safety
 * As `motord_wait`.
 */
enum motord_status motord_spin(struct motord_client *client,
                               uint64_t timeout_ns,
                               struct motord_state *state);

/**
 * Stores the newest state if this client has not returned it before; `is_new` becomes true if there is one. Does not wait. A lack of
 * states is no error here: `publish_ns` of `motord_cycle` shows their age.
 *
 * # Safety
 * `client` is a client, `state` a state; `is_new` leads to a place for a bool.
 */
enum motord_status motord_newest(struct motord_client *client,
                                 struct motord_state *state,
                                 bool *is_new);

/**
 * Reads the cycle of a state.
 *
 * # Safety
 * `state` is a state; `cycle` leads to a place for it.
 */
enum motord_status motord_state_cycle(struct motord_state *state, struct motord_cycle *cycle);

/**
 * Reads a `motord_quantity` of every joint of a group, in the order of the claim; NaN while it is unknown.
 *
 * # Safety
 * `state` is a state, `claim` a claim; `values` leads to `count` numbers.
 */
enum motord_status motord_read(struct motord_state *state,
                               struct motord_claim *claim,
                               uint32_t quantity,
                               size_t count,
                               double *values);

/**
 * As `motord_read`, with numbers of single precision.
 *
 * # Safety
 * As `motord_read`.
 */
enum motord_status motord_read_f32(struct motord_state *state,
                                   struct motord_claim *claim,
                                   uint32_t quantity,
                                   size_t count,
                                   float *values);

/**
 * Reads the group of a claim.
 *
 * # Safety
 * `state` is a state, `claim` a claim; `group` leads to a place for it.
 */
enum motord_status motord_state_group(struct motord_state *state,
                                      struct motord_claim *claim,
                                      struct motord_group *group);

/**
 * Checks that the group of a claim follows its setpoints: call it after each wait.
 *
 * # Safety
 * `state` is a state, `claim` a claim.
 */
enum motord_status motord_must_be_active(struct motord_state *state, struct motord_claim *claim);

/**
 * Reads a joint, by its index in the robot: `motord_find` and `motord_claim_joints` return it.
 *
 * # Safety
 * `state` is a state; `joint` leads to a place for it.
 */
enum motord_status motord_state_joint(struct motord_state *state,
                                      size_t index,
                                      struct motord_joint *joint);

/**
 * Returns the name of a `motord_mode`, such as `active`; null for a number that is none.
 */
const char *motord_mode_name(uint32_t mode);

/**
 * Returns the name of a `motord_fault`, such as `over-voltage`; null for a number that is none.
 */
const char *motord_fault_name(uint32_t fault);

/**
 * Returns the name of a `motord_limit`, such as `torque-slew`; null for a number that is none.
 */
const char *motord_limit_name(uint32_t limit);

/**
 * Reads an IMU, by its index in the robot.
 *
 * # Safety
 * `state` is a state; `imu` leads to a place for it.
 */
enum motord_status motord_state_imu(struct motord_state *state,
                                    size_t index,
                                    struct motord_imu *imu);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* MOTORD_H */
