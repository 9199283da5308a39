"""The sources of test-bridge-stops: `bridge-stops.py ORDERS SEED`; or `bridge-stops.py --best-effort`, one stop by a writer whose messages
need not arrive. A failed check ends it with an error.

Reads motord.log and bridge.log. Its last lines are the numbers of the run, which the rig adds to those of other robots.
"""

import asyncio
import http.client
import json
import random
import re
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass

import websockets
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from trigger import Request, Response

JOINTS = {f"{leg}-{joint}" for leg in ("fl", "fr", "rl", "rr") for joint in ("hip", "thigh", "knee")}
LONGEST = 30
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1))
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=5)), Policy.History.KeepLast(100))


@dataclass
class Empty(IdlStruct, typename="std_msgs::msg::dds_::Empty_"):
    structure_needs_at_least_one_member: uint8


def await_that(what, holds, seen=lambda: ""):
    end = time.monotonic() + LONGEST
    while not holds():
        assert time.monotonic() < end, f"not within {LONGEST} s: {what} {seen()}"
        time.sleep(0.01)


class Page:
    name = "the page"

    def stop(self, dies, delay):
        connection = http.client.HTTPConnection("127.0.0.1", 8642, timeout=LONGEST)
        connection.request("POST", "/api/stop", headers={"Origin": "http://127.0.0.1:8642"})
        if dies:
            # The head has arrived, and the caller goes.
            time.sleep(0.05)
            connection.close()
            return None
        answer = connection.getresponse()
        receipt = json.loads(answer.read())
        assert answer.status == 200 and set(receipt["joints_confirmed"]) == JOINTS and not receipt["joints_unconfirmed"], receipt
        return receipt


class Foxglove:
    name = "the Foxglove viewer"

    async def call(self, dies):
        socket = await websockets.connect("ws://127.0.0.1:8765", subprotocols=["foxglove.sdk.v1"], max_size=None, max_queue=None)
        service = None
        while service is None:
            message = await asyncio.wait_for(socket.recv(), LONGEST)
            # The schemas of the channels are long, and are not needed here.
            if isinstance(message, str) and "advertiseServices" in message[:50] and json.loads(message)["op"] == "advertiseServices":
                services = {service["name"]: service["id"] for service in json.loads(message)["services"]}
                service = services.get("/motord/stop")
        await socket.send(struct.pack("<BIII", 2, service, 1, 4) + b"json{}")
        if dies:
            await asyncio.sleep(0.05)
            await socket.close()
            return None
        while True:
            message = await asyncio.wait_for(socket.recv(), LONGEST)
            if isinstance(message, bytes) and message[0] == 3:
                _, _, length = struct.unpack_from("<III", message, 1)
                receipt = json.loads(message[13 + length:])
                assert set(receipt["confirmed"]) == JOINTS, receipt
                await socket.close()
                return receipt
            assert not isinstance(message, str) or json.loads(message)["op"] != "serviceCallFailure", message

    def stop(self, dies, delay):
        return asyncio.run(self.call(dies))


class RosTopic:
    name = "the topic /motord/stop"

    def __init__(self, participant, qos=RELIABLE):
        self.writer = DataWriter(participant, Topic(participant, "rt/motord/stop", Empty, qos=qos), qos=qos)
        await_that("the bridge reads the topic", self.writer.get_matched_subscriptions)

    def stop(self, dies, delay):
        # A topic has no receipt: the line in the log is all.
        self.writer.write(Empty(0))


class RosService:
    name = "the service /motord/stop"

    def __init__(self, participant):
        topic = lambda name, kind: Topic(participant, name, kind, qos=RELIABLE)
        self.writer = DataWriter(participant, topic("rq/motord/stopRequest", Request), qos=RELIABLE)
        self.reader = DataReader(participant, topic("rr/motord/stopReply", Response), qos=RELIABLE)
        self.number = 0
        await_that("the bridge serves the stop", lambda: self.writer.get_matched_subscriptions() and self.reader.get_matched_publications())

    def stop(self, dies, delay):
        self.number += 1
        self.writer.write(Request(0x1234_5678, self.number, 0))
        if dies:
            return None
        end = time.monotonic() + LONGEST
        while time.monotonic() < end:
            for response in self.reader.take(N=10):
                if response.sample_info.valid_data and response.number == self.number:
                    assert response.success, response.message
                    return response.message
            time.sleep(0.001)
        raise AssertionError("no answer of the service")


class Program:
    """A process with a stop of its own, which may be killed at any moment."""

    def __init__(self, name, *command):
        self.name, self.command = name, command

    def stop(self, dies, delay):
        process = subprocess.Popen(self.command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if dies:
            time.sleep(delay)
            process.kill()
            process.communicate()
            return None
        text, _ = process.communicate(timeout=LONGEST)
        assert process.returncode == 0, text
        return text


class Log:
    """A log that a program writes; `text` is what it wrote since the order began."""

    def __init__(self, path):
        self.file, self.read = open(path), ""
        self.begin()

    def begin(self):
        self.file.seek(0, 2)
        self.read = ""

    @property
    def text(self):
        self.read += self.file.read()
        return self.read


def motorctl(*arguments):
    """Its output. It waits for a state for 0.3 s only, which a machine with other load may take from it: then it is called again."""
    end = time.monotonic() + LONGEST
    while True:
        result = subprocess.run(["motorctl", *arguments], capture_output=True, text=True)
        if result.returncode == 0:
            return result.stdout
        assert result.returncode == 69 and time.monotonic() < end, f"motorctl {arguments[0]}: {result.returncode}, {result.stderr}"
        print(f"  called again: motorctl {arguments[0]}: {result.stderr.strip()}")


def group():
    return json.loads(motorctl("status", "--json"))["groups"][0]


def stop_at_once(dice, sources, dying):
    """All sources, shifted by some milliseconds. Returns how many of them have a receipt."""
    failures, threads, receipts = [], [], []

    def run(source, wait, dies, delay):
        time.sleep(wait)
        try:
            receipt = source.stop(dies, delay)
            assert dies or receipt or isinstance(source, RosTopic), "no receipt"
            if receipt and not dies:
                receipts.append(receipt)
        except BaseException as error:
            failures.append(f"{source.name}: {error!r}")

    for source in dice.sample(sources, len(sources)):
        threads.append(threading.Thread(target=run, args=(source, dice.random() * 0.02, source in dying, dice.random() * 0.02)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(2 * LONGEST)
        assert not thread.is_alive(), "a source hangs"
    assert not failures, failures
    return len(receipts)


def order(number, dice, sources, daemon, bridge):
    """One order. Returns how many sources died, how many have a receipt, how often the guest stalled, and the cause."""
    daemon.begin()
    bridge.begin()
    dying = {source for source in sources if dice.random() < 0.2}
    dying -= {sources[number % len(sources)]}
    receipts = stop_at_once(dice, sources, dying)
    # A source that died without a process of its own had sent its request.
    bridged = [source for source in sources if not isinstance(source, Program)]
    requests = lambda: {source: bridge.text.count(f"emergency stop by {source.name}") for source in bridged}
    complete = lambda: all(1 <= count <= most(source, bridge.text) for source, count in requests().items())
    seen = lambda: {source.name: (count, source in dying) for source, count in requests().items()}
    await_that("one line for each request (lines, dies)", complete, seen)
    stop = group()["stop"]
    assert stop and stop["cause"] == "emergency-stop", stop
    by = stop["asked_by"]["program"] or "a program that has ended"
    names = ["motord-bridge: " + source.name for source in bridged] + ["motorctl", "stop: the client of the rig"]
    # The kernel does not tell the program of a process that is gone.
    names += ["a program that has ended"] * any(isinstance(source, Program) for source in dying)
    assert any(by.startswith(name) for name in names), by
    latches = lambda: len(re.findall(LATCH, daemon.text))
    known = stalls(bridge.text)
    await_that("one latch", lambda: 1 <= latches() <= 1 + known)
    if number % 100 == 0:
        print(f"  order {number}: {len(dying)} of {len(sources)} die; stopped by {by}")
    motorctl("reset", "--wait")
    while group()["stop"] is not None:
        assert stalls(bridge.text) > known, "only a reset clears it, and it does"
        known += 1
        motorctl("reset", "--wait")
    assert 1 <= latches() <= 1 + stalls(bridge.text), "a second latch"
    # Without the number of a viewer and the address behind the page.
    return len(dying), receipts, stalls(bridge.text), re.sub(r" \d+$", "", by.split(",")[0])


def stalls(text):
    """A guest that stalls has a chip that does not answer, which stops the robot once more."""
    return text.count("does not answer for 200 ms")


def most(source, text):
    """The largest number of lines for one request."""
    if isinstance(source, RosTopic):
        # Both subscriptions, the reliable one and the other, get the message of a reliable writer.
        return 2
    return 1 + stalls(text) if "GPIO" in source.name else 1


LATCH = r"cause=\"?emergency-stop"


def main(orders, seed):
    print(f"seed {seed}")
    await_that("the bridge serves", lambda: "page: http" in open("bridge.log").read())
    participant = DomainParticipant(0)
    repeat(orders, random.Random(seed), all_sources(participant))


def stop_best_effort():
    """The writer repeats its message, as one does whose messages may be lost."""
    await_that("no earlier stop", lambda: group()["stop"] is None)
    source = RosTopic(DomainParticipant(0), BEST_EFFORT)

    def stopped():
        source.stop(False, 0)
        time.sleep(0.05)
        return group()["stop"] is not None

    await_that("the stop of a best-effort writer counts", stopped)
    motorctl("reset", "--wait")


def all_sources(participant):
    return [
        Page(),
        Foxglove(),
        RosTopic(participant),
        RosService(participant),
        Program("motorctl", "motorctl", "estop"),
        Program("the client", "stop", "the client of the rig"),
    ]


def repeat(orders, dice, sources):
    died, receipts, stalled, first = 0, 0, 0, {}
    daemon, bridge = Log("motord.log"), Log("bridge.log")
    for number in range(orders):
        dead, received, stall, by = order(number, dice, sources, daemon, bridge)
        died, receipts, stalled = died + dead, receipts + received, stalled + stall
        first[by] = first.get(by, 0) + 1
    for count, what in [(orders, f"orders of {len(sources)} sources, one latch each"), (orders * len(sources), "requests"),
                        (died, "requests of sources that died"), (receipts, "receipts, none lost"),
                        *[(stalled, "stalls of the guest, each a stop more")] * (stalled > 0),
                        *((count, f"named {by}") for by, count in sorted(first.items(), key=lambda item: -item[1]))]:
        print(f"{count} {what}")


if __name__ == "__main__":
    if sys.argv[1] == "--best-effort":
        stop_best_effort()
    else:
        main(int(sys.argv[1]), sys.argv[2])
