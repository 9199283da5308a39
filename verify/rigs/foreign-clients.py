"""Clients of other projects move motord's simulated motors, and their frames are recorded.

foreign-clients.py CLIENT: runs this client, and prints rows for motors/protocol/tests/foreign.csv: the frame that the client sent for a
command with these values, and the values that it read from a frame of the motor.
"""

import asyncio
import math
import socket
import struct
import sys
import time

EXTENDED = socket.CAN_EFF_FLAG
# Far from the middle of the codes, and each at another place: position, velocity, kp, kd, torque.
PROBE = (0.31, 1.5, 21.0, 0.7, 0.9)
# Where the joint is led, rad.
GOAL = 0.3


class Wire:
    """Sees the frames of every process on an interface; with ids, only those with one of them."""

    def __init__(self, interface, ids=()):
        self.socket = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        if ids:
            filters = b"".join(struct.pack("=II", ident, socket.CAN_SFF_MASK) for ident in ids)
            self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        self.socket.bind((interface,))
        self.socket.settimeout(0.05)

    def frames(self, action):
        """Returns the result of an action, and the frames up to 50 ms of silence after it."""
        self.drain()
        result = action()
        return result, self.drain()

    def receive(self):
        ident, length, payload = struct.unpack("=IB3x8s", self.socket.recv(16))
        return ident, payload[:length].hex().upper()

    def drain(self):
        frames = []
        while len(frames) <= 200:
            try:
                frames.append(self.receive())
            except TimeoutError:
                break
        return frames


def name(ident):
    return f"{ident & socket.CAN_EFF_MASK:08X}" if ident & EXTENDED else f"{ident:03X}"


def row(direction, client, motor, what, frame, values=()):
    ident, payload = frame
    numbers = " ".join(f"{value:.6g}" for value in values)
    print(f"{direction},{client},{motor},{what},{name(ident)},{payload},{numbers}", flush=True)


class Run:
    """A client with one motor: `command` sends an impedance, `state` returns position, velocity and torque."""

    def __init__(self, client, motor, interface, is_command, ids=()):
        self.client, self.motor, self.wire, self.is_command = client, motor, Wire(interface, ids), is_command

    def send(self, what, action, values=(), which=0):
        """Records the first command of an action, or another one."""
        result, frames = self.wire.frames(action)
        sent = [frame for frame in frames if self.is_command(frame[0])]
        assert sent, f"{self.client} sent nothing for {what}: {frames}"
        row("to-motor", self.client, self.motor, what, sent[which], values)
        return result, frames

    def move(self, command, state):
        for step in range(101):
            command(GOAL * step / 100, 0.0, 20.0, 1.0, 0.0)
            time.sleep(0.01)
        deadline = time.monotonic() + 5
        while abs(state()[0] - GOAL) > 0.03:
            assert time.monotonic() < deadline, f"{self.client}: the motor is at {state()}"
            command(GOAL, 0.0, 20.0, 1.0, 0.0)
            time.sleep(0.01)
        print(f"# {self.client}: {self.motor} is at {state()[0]:.3f} rad", flush=True)

    def probe(self, command, state, is_reply):
        """Records a command with unequal values, and the values read from the answer."""
        _, frames = self.send("control", lambda: command(*PROBE), PROBE)
        replies = [frame for frame in frames if is_reply(frame[0])]
        assert replies, f"{self.client}: no answer to its command: {frames}"
        row("from-motor", self.client, self.motor, "state", replies[-1], state())


def motorbridge(motor, interface, add, is_command, is_reply):
    from motorbridge import Controller, Mode

    with Controller(interface) as controller:
        handle = add(controller)
        run = Run("motorbridge 0.5.6", motor, interface, is_command)

        def state():
            deadline = time.monotonic() + 2
            while time.monotonic() < deadline:
                controller.poll_feedback_once()
                found = handle.get_state()
                if found is not None:
                    return found.pos, found.vel, found.torq
            raise AssertionError("motorbridge: no state")

        run.send("enable", handle.enable)
        run.move(handle.send_mit, state)
        run.probe(handle.send_mit, state, is_reply)
        run.send("disable", handle.disable)


def damiao_motorbridge():
    motorbridge(
        "DM-J4310-2EC", "vcan0", lambda controller: controller.add_damiao_motor(1, 0x11, "4310"), lambda i: i == 1, lambda i: i == 0x11
    )


def robstride_motorbridge():
    motorbridge(
        "RS02",
        "vcan1",
        lambda controller: controller.add_robstride_motor(1, 0xFD, "rs-02"),
        lambda i: i & EXTENDED and i & 0xFF == 1,
        lambda i: i & EXTENDED and i >> 24 & 0x1F == 2,
    )


def damiao_motor():
    from damiao_motor import DaMiaoController

    controller = DaMiaoController(channel="vcan0", bustype="socketcan")
    motor = controller.add_motor(motor_id=1, feedback_id=0x11, motor_type="4310")
    run = Run("damiao-motor 1.0.6", "DM-J4310-2EC", "vcan0", lambda i: i == 1)

    def command(position, velocity, kp, kd, torque):
        motor.send_cmd_mit(position, velocity, kp, kd, torque)

    def state():
        time.sleep(0.02)
        states = motor.get_states()
        return states["pos"], states["vel"], states["torq"]

    run.send("clear-fault", motor.clear_error)
    run.send("enable", motor.enable)
    run.move(command, state)
    run.probe(command, state, lambda i: i == 0x11)
    run.send("disable", motor.disable)
    run.send("zero", motor.set_zero_position)
    controller.shutdown()


def robstride_dynamics():
    from robstride_dynamics.bus import Motor, RobstrideBus

    bus = RobstrideBus("vcan1", {"rs": Motor(1, "rs-02")})
    bus.connect()
    run = Run("robstride-dynamics 0.0.1", "RS02", "vcan1", lambda i: i & EXTENDED and i & 0xFF == 1)
    last = []

    def command(position, velocity, kp, kd, torque):
        bus.write_operation_frame("rs", position, kp, kd, velocity, torque)
        last[:] = bus.read_operation_frame("rs")

    run.send("device", lambda: bus.read_id("rs", 1.0))
    run.send("enable", lambda: bus.enable("rs"))
    run.move(command, lambda: last[:3])
    run.probe(command, lambda: last, lambda i: i & EXTENDED and i >> 24 & 0x1F == 2)
    run.send("disable", lambda: bus.disable("rs"))
    bus.disconnect()


def robstride():
    import can
    from robstride.client import Client

    bus = can.Bus(interface="socketcan", channel="vcan1")
    client = Client(bus)
    run = Run("robstride 0.1.0", "RS02", "vcan1", lambda i: i & EXTENDED and i & 0xFF == 1)
    # The simulated motor has no position mode of its own: this client can only enable it and read it.
    run.send("enable", lambda: client.enable(1))
    position = client.read_param(1, "mechpos")
    state, frames = run.send("disable", lambda: client.disable(1))
    assert abs(position - state.angle) < 0.1, f"robstride: mechpos {position}, angle {state.angle}"
    print(f"# robstride 0.1.0: RS02 is at {position:.3f} rad", flush=True)
    reply = [frame for frame in frames if frame[0] & EXTENDED and frame[0] >> 24 & 0x1F == 2][-1]
    row("from-motor", run.client, "RS02", "state", reply, (state.angle, state.velocity, state.torque, state.temp))


def myactuator_motorbridge():
    from motorbridge import Controller

    with Controller("vcan0") as controller:
        handle = controller.add_myactuator_motor(2, 0x242, "X8")
        run = Run("motorbridge 0.5.6", "X8-20", "vcan0", lambda i: i == 0x142)
        # It moves a motor by modes that the simulated motor does not have: it can only read and stop it.
        _, frames = run.send("motion", handle.request_feedback)
        controller.poll_feedback_once()
        state = handle.get_state()
        row("from-motor", run.client, run.motor, "motion", [frame for frame in frames if frame[0] == 0x242][-1], (state.vel, state.t_mos))
        print(f"# motorbridge 0.5.6: X8-20 has {state.t_mos:.0f} degrees", flush=True)
        run.send("disable", handle.disable)


def tmotor():
    import os

    # It opens no interface of another name.
    for line in "can0 down", "can0 name other0", "vcan2 down", "vcan2 name can0", "can0 up":
        assert os.system(f"ip link set {line}") == 0, line
    from TMotorCANControl.mit_can import CAN_Manager

    manager = CAN_Manager()
    run = Run("TMotorCANControl 1.2.6", "AK80-9", "can0", lambda i: i == 1)
    seen = []
    manager.notifier.add_listener(lambda message: seen.append(bytes(message.data)) if message.arbitration_id == 0 else None)

    def command(position, velocity, kp, kd, torque):
        manager.MIT_controller(1, "AK80-9", position, velocity, kp, kd, torque)

    def state():
        time.sleep(0.02)
        found = manager.parse_MIT_message(seen[-1], "AK80-9")
        return found.position, found.velocity, found.current

    run.send("enable", lambda: manager.power_on(1))
    run.move(command, state)
    run.probe(command, state, lambda i: i == 0)
    run.send("disable", lambda: manager.power_off(1))
    run.send("zero", lambda: manager.zero(1))
    manager.notifier.stop()


def mini_cheetah():
    from motor_driver.canmotorlib import CanMotorController

    motor = CanMotorController("vcan4", 1, "AK80_6_V2", socket_timeout=1.0)
    # It hides its frames from the other programs of its machine, which here are the motor.
    CanMotorController.motor_socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_LOOPBACK, 1)
    run = Run("mini-cheetah-motor-driver-socketcan 0.4.3", "AK80-6", "vcan4", lambda i: i == 1)
    last = []

    def command(*values):
        last[:] = motor.send_rad_command(*values)

    run.send("zero", motor.set_zero_position)
    # Before it enables the motor it sets its zero, and before it disables the motor it sends a control frame.
    run.send("enable", motor.enable_motor, which=-1)
    run.move(command, lambda: last)
    run.probe(command, lambda: last, lambda i: i == 0)
    run.send("disable", motor.disable_motor, which=-1)


def odrive_can():
    import can
    from odrive_can.odrive import ODriveCAN

    async def use():
        bus = can.Bus(interface="socketcan", channel="vcan3")
        driver = ODriveCAN(1, bus)
        await driver.start()
        run = Run("odrive-can 2.1.0", "GIM6010-8", "vcan3", lambda i: i in (0x27, 0x2B))
        run.send("mode", lambda: driver._send_message("Set_Controller_Mode", {"Control_Mode": 3, "Input_Mode": 9}))
        run.send("closed-loop", lambda: driver._send_message("Set_Axis_State", {"Axis_Requested_State": "CLOSED_LOOP_CONTROL"}))
        for _ in range(50):
            await asyncio.sleep(0.1)
            if driver.axis_state == "CLOSED_LOOP_CONTROL":
                break
        assert driver.axis_state == "CLOSED_LOOP_CONTROL", driver.axis_state
        print(f"# odrive-can 2.1.0: GIM6010-8 is in {driver.axis_state}", flush=True)
        run.send("idle", driver.stop)

    asyncio.run(use())


def odrive():
    import can
    from odrive_can.odrive import CanMsg, ODriveCAN

    async def use():
        driver = ODriveCAN(2, can.Bus(interface="socketcan", channel="vcan5"))
        turns = [math.nan]
        driver.feedback_callback = lambda message, _: turns.append(message.data["Pos_Estimate"])
        await driver.start()
        # The drive sends frames without an end: only the commands are seen.
        run = Run("odrive-can 2.1.0", "ODrive-S1", "vcan5", lambda i: True, [0x47, 0x4B, 0x4C, 0x4D, 0x4E, 0x58, 0x59])

        def mode(quantity):
            run.send(f"{quantity}-mode", lambda: driver.set_controller_mode(f"{quantity.upper()}_CONTROL", "PASSTHROUGH"))

        async def wait(what, is_done):
            deadline = time.monotonic() + 5
            while not is_done():
                assert time.monotonic() < deadline, f"odrive-can: {what}: {driver.axis_state}, {turns[-1]} turns"
                await asyncio.sleep(0.1)

        run.send("clear-errors", driver.clear_errors)
        run.send("zero", lambda: driver.set_linear_count(0))
        mode("torque")
        run.send("torque", lambda: driver.set_input_torque(0.9), [0.9])
        mode("velocity")
        run.send("velocity", lambda: driver.set_input_vel(1.5), [1.5])
        mode("position")
        run.send("position", lambda: driver.set_input_pos(0.31), [0.31])
        # Of the inputs to a disabled drive, it follows only that of its mode.
        run.send("closed-loop", lambda: driver.set_axis_state_no_wait("CLOSED_LOOP_CONTROL"))
        await wait("closed loop", lambda: driver.axis_state == "CLOSED_LOOP_CONTROL")
        await wait("position", lambda: abs(turns[-1] - 0.31) < 0.01)
        print(f"# odrive-can 2.1.0: ODrive-S1 is at {turns[-1]:.3f} turns", flush=True)
        frame = Wire("vcan5", [0x49]).receive()
        data = CanMsg(can.Message(arbitration_id=frame[0], data=bytes.fromhex(frame[1]))).data
        row("from-motor", run.client, run.motor, "estimates", frame, (data["Pos_Estimate"], data["Vel_Estimate"]))
        run.send("idle", driver.stop)

    asyncio.run(use())


CLIENTS = [
    damiao_motorbridge,
    damiao_motor,
    robstride_motorbridge,
    robstride_dynamics,
    robstride,
    odrive_can,
    myactuator_motorbridge,
    tmotor,
    mini_cheetah,
    odrive,
]

if __name__ == "__main__":
    {client.__name__: client for client in CLIENTS}[sys.argv[1]]()
