"""The part of test-bridge-inputs in the guest: a gamepad of uinput, a GPIO chip of uhid, a robot and the bridge."""

import fcntl
import glob
import importlib
import json
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import threading
import time

KEY, ABS, SYN = 1, 3, 0
SOUTH, EAST, TL = 0x130, 0x131, 0x136
X, Y, RX = 0, 1, 3
NAME = "Pad of the rig"
ROBOT = """
[daemon]
instance = "demo"
[cycle]
rate-hz = 200
max-lateness-ms = 1000.0
max-skipped-percent = 100
[safety]
setpoint-timeout-ms = 1000.0
lost-cycles = 100
deadman-ms = 1000.0
start-timeout-ms = 5000.0
[[bus]]
name = "left"
type = "simulated"
{}
[[group]]
name = "legs"
joints = ["hip", "knee"]
"""
MOTOR = """
[[motor]]
name = "{}"
bus = "left"
id = {}
protocol = "mit"
model = "GIM8108-8"
direction = 1
limits = {{ position-rad = [-0.9, 0.9], velocity-rad-s = 25.0, torque-nm = 20.0 }}
simulation = {{ initial-position-rad = 0.0 }}
"""


class Pad:
    """A gamepad of uinput."""

    def __init__(self):
        self.file = os.open("/dev/uinput", os.O_WRONLY | os.O_NONBLOCK)
        for request, values in [(0x40045564, [KEY, ABS]), (0x40045565, [SOUTH, EAST, TL]), (0x40045567, [X, Y, RX])]:
            for value in values:
                fcntl.ioctl(self.file, request, value)
        for axis in (X, Y, RX):
            fcntl.ioctl(self.file, 0x401C5504, struct.pack("=HH6i", axis, 0, 0, -32768, 32767, 0, 128, 0))
        fcntl.ioctl(self.file, 0x405C5503, struct.pack("=4H80sI", 3, 0x1234, 0x5678, 1, NAME.encode(), 0))
        fcntl.ioctl(self.file, 0x5501)

    def send(self, *events):
        """One report."""
        for kind, code, value in [*events, (SYN, 0, 0)]:
            os.write(self.file, struct.pack("@llHHi", 0, 0, kind, code, value))

    def unplug(self):
        fcntl.ioctl(self.file, 0x5502)
        os.close(self.file)


class Chip:
    """The USB side of an MCP2221, whose line 0 is open or closed to ground."""

    # A report of 64 bytes in each direction.
    REPORTS = bytes([0x06, 0, 0xFF, 0x09, 1, 0xA1, 1, 0x15, 0, 0x26, 0xFF, 0, 0x75, 8, 0x95, 64, 0x09, 1, 0x81, 2, 0x09, 2, 0x91, 2, 0xC0])

    def __init__(self, is_open=False):
        # Of both processes: whether the line is open, and whether the chip answers.
        self.state = mmap.mmap(-1, 2)
        self.is_open, self.answers = is_open, True
        before = set(glob.glob("/dev/gpiochip*"))
        self.file = os.open("/dev/uhid", os.O_RDWR)
        create = struct.pack("=I128s64s64sHHIIII", 11, b"MCP2221 of the rig", b"", b"", len(self.REPORTS), 3, 0x04D8, 0x00DD, 0, 0)
        os.write(self.file, create + self.REPORTS.ljust(4096, b"\0"))
        self.process = os.fork()
        if self.process == 0:
            self.serve()
        added = lambda: sorted(set(glob.glob("/dev/gpiochip*")) - before)
        await_that("the chip has a device", added)
        # Its number may change, as at a real port: a link has the name that stays.
        if os.path.islink("chip"):
            os.unlink("chip")
        os.symlink(added()[0], "chip")

    is_open = property(lambda self: self.state[0] != 0, lambda self, value: self.state.__setitem__(0, value))
    answers = property(lambda self: self.state[1] != 0, lambda self, value: self.state.__setitem__(1, value))

    def serve(self):
        """Answers as a chip does, whatever else this guest computes. Never returns."""
        # Pipes of other processes, whose readers await their end.
        os.closerange(3, self.file)
        os.closerange(self.file + 1, 4096)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        while True:
            event = os.read(self.file, 8192)
            if struct.unpack_from("=I", event)[0] == 6:
                self.answer(event[4])

    def answer(self, command):
        if self.answers:
            # Of each line the value and the direction, in an order that differs among versions of the driver.
            lines = [int(self.is_open)] * 2 + [1] * 6 if command == 0x51 else []
            answer = bytes([command, 0, *lines]).ljust(64, b"\0")
            os.write(self.file, struct.pack("=IH", 12, 64) + answer.ljust(4096, b"\0"))

    def unplug(self):
        os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        os.write(self.file, struct.pack("=I", 1))
        os.close(self.file)


def await_that(what, holds, seconds=60):
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            fail(f"not within {seconds} s: {what}")
        time.sleep(0.02)


def fail(why):
    for log in ("bridge.log", "motord.log"):
        print(f"--- {log}\n" + "".join(open(log).readlines()[-40:]))
    sys.exit(f"test-bridge-inputs: {why}: {json.dumps(group())}")


def group():
    status = subprocess.run(["motorctl", "status", "--json"], capture_output=True, text=True).stdout
    return json.loads(status)["groups"][0]


def cause():
    stop = group()["stop"]
    return stop and stop["cause"]


class Log:
    """The log of the bridge, of which each call reads what is new: the last part of the rig lets it grow."""

    def __init__(self):
        self.file, self.text, self.lock = open("bridge.log"), "", threading.Lock()

    def __call__(self):
        with self.lock:
            self.text += self.file.read()
            return self.text


def stops():
    """The number of receipts."""
    return log().count("emergency stop by ")


def start(*command, log="/dev/null"):
    return subprocess.Popen(command, stdout=open(log, "a"), stderr=subprocess.STDOUT)


class Bridge:
    def __init__(self, lines):
        with open("bridge.toml", "w") as file:
            file.write('[robot]\ninstance = "demo"\n[ros2]\njoint-states-hz = 0.0\nimu-hz = 0.0\ngroup-states-hz = 0.0\n' + lines)
        global log
        open("bridge.log", "w").close()
        log = Log()
        self.process = start("motord-bridge", "run", "--config", "bridge.toml", log="bridge.log")

    def end(self):
        self.process.terminate()
        if self.process.wait() != 0:
            fail("the bridge did not end with status 0")


def hold():
    """Clears the stop, and has a controller hold the pose."""
    subprocess.run(["motorctl", "reset", "--wait"], capture_output=True)
    start("hold", "--group", "legs", log="hold.log")
    await_that("the robot holds its pose", lambda: group()["phase"] == "active")


def expect_stop(what, *parts):
    """One latched stop, whose cause names the bridge and the source."""
    # The state and its history come one after the other.
    await_that(f"stopped by {what}", lambda: cause() == "emergency-stop" and (group()["stop"].get("asked_by") or {}).get("program"))
    by = group()["stop"]["asked_by"]["program"]
    if not by.startswith("motord-bridge: ") or not all(part in by for part in parts):
        fail(f"the cause of {what} names {by!r}")
    await_that("a receipt", lambda: "confirmed after" in log())
    print(f"  {what}: {by}")


def expect_no_stop(what, seconds=1.0):
    time.sleep(seconds)
    if group()["phase"] != "active":
        fail(f"{what} stopped the robot")
    print(f"  {what}: the robot holds its pose")


def reset_leads_to_stop(what):
    before = stops()
    subprocess.run(["motorctl", "reset"], capture_output=True)
    await_that(f"another stop by {what}", lambda: stops() > before and cause() == "emergency-stop")
    time.sleep(0.5)
    if stops() != before + 1:
        fail(f"{stops() - before} stops after one reset")
    print(f"  {what}: a reset leads to one more stop")


def reset():
    subprocess.run(["motorctl", "reset", "--wait"], capture_output=True)
    time.sleep(0.5)
    if cause():
        fail("a reset is followed by a stop")


def gamepad_alone():
    print("--- gamepad: button B")
    pad = Pad()
    bridge = Bridge("[gamepad]\nenabled = true\n")
    await_that("the gamepad is found", lambda: NAME in log())
    hold()
    pad.send((ABS, X, 32767), (KEY, SOUTH, 1))
    expect_no_stop("another button")
    for value in (100000, -100000, 2**31 - 1):
        pad.send((ABS, X, value))
    for number in range(5000):
        pad.send((ABS, X, number), (ABS, Y, -number), (ABS, RX, number))
        # A guest with one processor has a controller beside them.
        time.sleep(0.001 if number % 50 == 0 else 0.0)
    expect_no_stop("20 000 events")
    # Both in the queue before the bridge reads one.
    pad.send((KEY, EAST, 1))
    pad.send((KEY, EAST, 0))
    expect_stop("a short press of B", NAME, "button B")
    reset()
    pad.send((KEY, EAST, 1))
    expect_stop("a press of B", NAME)
    reset_leads_to_stop("a pressed B")
    pad.send((KEY, EAST, 0))
    reset()
    hold()
    pad.unplug()
    await_that("the loss is logged", lambda: "is lost" in log())
    expect_no_stop("a gamepad that is unplugged, without a dead man's button")
    pad = Pad()
    await_that("the gamepad is found again", lambda: log().count(f"gamepad {NAME} at") == 2)
    pad.send((KEY, EAST, 1))
    expect_stop("B of the gamepad that returned", NAME)
    pad.unplug()
    bridge.end()
    reset()


def dead_man():
    print("--- gamepad: dead man's button")
    pad = Pad()
    bridge = Bridge('[gamepad]\nenabled = true\ndead-man = "tl"\n')
    await_that("the gamepad is found", lambda: NAME in log())
    time.sleep(1)
    if cause():
        fail("a resting robot is stopped")
    pad.send((KEY, TL, 1))
    time.sleep(0.1)
    hold()
    expect_no_stop("a held button")
    pad.send((KEY, TL, 0))
    expect_stop("the released button", "dead man's button tl released")
    reset()
    start("hold", "--group", "legs", log="hold.log")
    expect_stop("a start without the button", "dead man's button")
    reset()
    pad.send((KEY, TL, 1))
    time.sleep(0.1)
    hold()
    pad.unplug()
    # The kernel releases the buttons of a device before it removes the device.
    expect_stop("the unplugged gamepad", "the gamepad")
    bridge.end()
    reset()


def circuit():
    print("--- GPIO")
    chip = Chip()
    bridge = Bridge('[gpio]\nenabled = true\nchip = "/tmp/rig/chip"\nline = 0\nrun-level = "low"\ndebounce-ms = 50.0\n')
    await_that("the line is closed", lambda: "is closed" in log())
    hold()
    expect_no_stop("a closed line")
    chip.is_open = True
    time.sleep(0.01)
    chip.is_open = False
    expect_no_stop("a pulse of 10 ms")
    chip.is_open = True
    expect_stop("the open line", "line 0 of /tmp/rig/chip", "open")
    reset_leads_to_stop("an open line")
    chip.is_open = False
    time.sleep(0.5)
    reset()
    hold()
    chip.answers = False
    expect_stop("a chip that does not answer", "does not answer")
    chip.answers = True
    await_that("the chip answers", lambda: log().count("is closed") >= 3)
    reset()
    hold()
    chip.unplug()
    expect_stop("the unplugged chip", "line 0")
    reset_leads_to_stop("a missing chip")
    chip = Chip()
    await_that("the line is closed again", lambda: log().count("is closed") >= 4)
    reset()
    hold()
    expect_no_stop("the chip that returned")
    bridge.end()
    chip.unplug()


def values():
    print("--- motord-bridge gamepad --json")
    pad = Pad()
    shown = subprocess.Popen(["motord-bridge", "gamepad", "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    def await_line(what, holds):
        for line in shown.stdout:
            if holds(json.loads(line)):
                print(f"  {what}: {line.strip()[:70]}")
                return
        fail(what)

    await_line("connected", lambda line: line["connected"] and line["name"] == NAME)
    pad.send((ABS, X, -32768), (KEY, SOUTH, 1))
    await_line("a stick and a button", lambda line: line["axes"]["left-x"] == 1.0 and line["buttons"]["south"])
    pad.send((ABS, X, 40000))
    await_line("a value out of its range", lambda line: line["axes"]["left-x"] == 0.0 and line["buttons"]["south"])
    pad.unplug()
    released = lambda line: not line["connected"] and not any(line["axes"].values()) and not any(line["buttons"].values())
    await_line("unplugged", released)
    shown.kill()


class PadSource:
    """Button B of a gamepad, which is unplugged where it dies."""

    name = f"the gamepad {NAME}"

    def __init__(self):
        self.pad = Pad()

    def stop(self, dies, delay):
        before = len(log())
        self.pad.send((KEY, EAST, 1))
        await_that("a receipt of the gamepad", lambda: log().count(f"emergency stop by {self.name}", before))
        if dies:
            self.pad.unplug()
            self.pad = Pad()
            await_that("the gamepad is found again", lambda: log().count(f"gamepad {NAME} at", before) == 1)
        else:
            self.pad.send((KEY, EAST, 0))
        # The bridge has seen the release before the reset.
        time.sleep(0.1)
        return True


class LineSource:
    """A stop circuit that is opened, and closed after the receipt. Where it dies, its chip is unplugged."""

    name = "the GPIO line 0 of /tmp/rig/chip"

    def __init__(self):
        self.chip, self.seen = Chip(), 0

    def demands_stop(self):
        """A chip that does not answer, as that of a guest that stalled, demands a stop as an open line does."""
        last = lambda state: log().rfind(f"{self.name} {state}")
        return max(map(last, ["is open", "is lost", "does not answer"])) > last("is closed")

    def stop(self, dies, delay):
        self.chip.is_open = True
        await_that("the open line demands a stop", self.demands_stop)
        await_that("a receipt of the line", lambda: log().count(f"emergency stop by {self.name}", self.seen))
        if dies:
            self.chip.unplug()
            self.chip = Chip()
        self.chip.is_open = False
        await_that("the closed line demands none", lambda: not self.demands_stop())
        self.seen = len(log())
        return True


def together(orders):
    print("--- eight sources at once")
    stops_of_all = importlib.import_module("bridge-stops")
    stops_of_all.JOINTS = {"hip", "knee"}
    line, pad = LineSource(), PadSource()
    bridge = Bridge(
        '[gamepad]\nenabled = true\n[gpio]\nenabled = true\nchip = "/tmp/rig/chip"\nline = 0\n'
        "[web]\nenabled = true\n[foxglove]\nenabled = true\n"
    )
    await_that("both devices are found", lambda: NAME in log() and "is closed" in log())
    seed = random.randrange(10000)
    print(f"seed {seed}")
    participant = stops_of_all.DomainParticipant(0)
    try:
        stops_of_all.repeat(orders, random.Random(seed), [*stops_of_all.all_sources(participant), pad, line])
    except BaseException as error:
        # Both are gone with the guest.
        fail(repr(error))
    bridge.end()


with open("robot.toml", "w") as file:
    file.write(ROBOT.format(MOTOR.format("hip", 1) + MOTOR.format("knee", 2)))
open("motord.log", "w").close()
open("bridge.log", "w").close()
motord = start("motord", "run", "--config", "robot.toml", log="motord.log")
await_that("motord is ready", lambda: " ready " in open("motord.log").read())
if not os.environ.get("RIG_ORDERS_ONLY"):
    values()
    gamepad_alone()
    dead_man()
    circuit()
together(int(sys.argv[1]))
motord.terminate()
print("passed")
