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
    """Sees the frames of every process on an interface."""

    def __init__(self, interface):
        self.socket = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.bind((interface,))
        self.socket.settimeout(0.05)

    def frames(self, action):
        """Returns the result of an action, and the frames up to 50 ms of silence after it."""
        self.drain()
        result = action()
        return result, self.drain()

    def drain(self):
        frames = []
        while True:
            try:
                ident, length, payload = struct.unpack("=IB3x8s", self.socket.recv(16))
            except TimeoutError:
                return frames
            frames.append((ident, payload[:length].hex().upper()))
            if len(frames) > 200:
                return frames


def name(ident):
    return f"{ident & socket.CAN_EFF_MASK:08X}" if ident & EXTENDED else f"{ident:03X}"


def row(direction, client, motor, what, frame, values=()):
    ident, payload = frame
    numbers = " ".join(f"{value:.6g}" for value in values)
    print(f"{direction},{client},{motor},{what},{name(ident)},{payload},{numbers}", flush=True)


class Run:
    """A client with one motor: `command` sends an impedance, `state` returns position, velocity and torque."""

    def __init__(self, client, motor, interface, is_command):
        self.client, self.motor, self.wire, self.is_command = client, motor, Wire(interface), is_command

    def send(self, what, action, values=()):
        """Records the first command of an action."""
        result, frames = self.wire.frames(action)
        sent = [frame for frame in frames if self.is_command(frame[0])]
        assert sent, f"{self.client} sent nothing for {what}: {frames}"
        row("to-motor", self.client, self.motor, what, sent[0], values)
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


CLIENTS = [damiao_motorbridge, damiao_motor, robstride_motorbridge, robstride_dynamics, robstride, odrive_can, myactuator_motorbridge, tmotor]

if __name__ == "__main__":
    {client.__name__: client for client in CLIENTS}[sys.argv[1]]()
