"""Viewers of motord-bridge, for test-bridge-foxglove, by Foxglove's WebSocket protocol. `bridge-foxglove.py MODE PORT [ARGUMENT...]`; a
failed check ends it with an error.

channels PORT           every channel and schema by both subprotocols; messages decode; parameters, their refused change, assets, status
rates PORT SECONDS      the messages of each topic per interval of its rate
watchers PORT SECONDS   20 viewers beside one that never reads, which then reads
ages PORT               the age of the states that the thread `motor` hands over
stop PORT               the service /motord/stop: its receipt names each motor
starved PORT            the same while connections use up the file descriptors of the bridge, and after them, by the same viewer and a new one
leaves PORT LOG         20 viewers that read nothing, stop and reset their connection at once: the log of the bridge names each stop
hostile PORT            random bytes, damaged and unknown messages, connections that use up the file descriptors
files MCAP              a recording in the reader of MCAP
"""

import asyncio
import base64
import collections
import json
import os
import pathlib
import random
import re
import socket
import struct
import sys
import time

import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

SUBPROTOCOLS = ["foxglove.sdk.v1", "foxglove.sdk.v1.1"]
JOINTS = [f"{leg}-{joint}" for leg in ("fl", "fr", "rl", "rr") for joint in ("hip", "thigh", "knee")]
# Cycles of 1 ms between two messages, by the configuration of the rig.
CYCLES = {"/joints/": 20, "/imus/": 20, "/groups/": 100, "/cycle": 100, "/buses/": 500}


class Viewer:
    """A connection, its channels by topic, and what it received."""

    def __init__(self, port):
        self.url = f"ws://127.0.0.1:{port}"
        self.channels, self.schemas, self.services = {}, {}, {}
        self.texts, self.calls, self.assets = [], {}, {}
        self.topics, self.messages = {}, collections.defaultdict(list)

    async def connect(self, subprotocol=SUBPROTOCOLS[0]):
        # The library's own queue would hold the messages of a viewer that does not read.
        self.socket = await websockets.connect(self.url, subprotocols=[subprotocol], max_size=None, max_queue=None)
        assert self.socket.subprotocol == subprotocol, self.socket.subprotocol
        await self.until(lambda: len(self.services) == 2 and "/robot" in self.channels, "channels and services")
        return self

    async def until(self, condition, what, limit=60):
        end = time.monotonic() + limit
        while not condition():
            left = end - time.monotonic()
            assert left > 0, f"no {what} within {limit} s"
            try:
                self.take(await asyncio.wait_for(self.socket.recv(), left))
            except asyncio.TimeoutError:
                pass

    async def read_for(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self.take(await asyncio.wait_for(self.socket.recv(), left))
            except asyncio.TimeoutError:
                return

    def take(self, message):
        if isinstance(message, bytes):
            return self.take_binary(message)
        text = json.loads(message)
        self.texts.append(text)
        if text["op"] == "advertise":
            for schema in text.get("schemas", []):
                self.schemas[schema["id"]] = schema
            for channel in text["channels"]:
                self.channels[channel["topic"]] = channel
        elif text["op"] == "advertiseServices":
            self.services.update({service["name"]: service for service in text["services"]})
        elif text["op"] == "serviceCallFailure":
            self.calls[text["callId"]] = text

    def take_binary(self, message):
        if message[0] == 1:
            subscription, time_ns = struct.unpack_from("<IQ", message, 1)
            self.messages[self.topics[subscription]].append((time_ns, message[13:]))
        elif message[0] == 3:
            _, call, length = struct.unpack_from("<III", message, 1)
            self.calls[call] = json.loads(message[13 + length:])
        elif message[0] == 4:
            request, status, _ = struct.unpack_from("<IBI", message, 1)
            self.assets[request] = (status, message[10:])

    async def send(self, **text):
        await self.socket.send(json.dumps(text))

    async def subscribe(self, topics=None):
        wanted = [self.channels[topic] for topic in topics or self.channels]
        self.topics.update({channel["id"]: channel["topic"] for channel in wanted})
        await self.send(op="subscribe", subscriptions=[{"id": channel["id"], "channelId": channel["id"]} for channel in wanted])

    async def call(self, service, number=1, encoding=b"json"):
        service = self.services[service]
        head = struct.pack("<BIII", 2, service["id"], number, len(encoding))
        await self.socket.send(head + encoding + b"{}")
        await self.until(lambda: number in self.calls, "answer of a service")
        return self.calls.pop(number)

    def schema(self, topic):
        """Name, encoding and content of the schema, inline or in the table."""
        channel = self.channels[topic]
        if "schemaId" in channel:
            schema = self.schemas[channel["schemaId"]]
            return schema["name"], schema["encoding"], schema["data"]
        return channel["schemaName"], channel.get("schemaEncoding"), channel["schema"]


class Decoder:
    """The messages of a topic, by the schema that the bridge sends."""

    def __init__(self, viewer):
        self.viewer, self.classes = viewer, {}

    def __call__(self, topic, content):
        if self.viewer.channels[topic]["encoding"] == "json":
            return json.loads(content)
        if topic not in self.classes:
            name, encoding, data = self.viewer.schema(topic)
            assert encoding == "protobuf", (topic, encoding)
            pool = descriptor_pool.DescriptorPool()
            for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(data)).file:
                pool.Add(file)
            self.classes[topic] = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        return self.classes[topic].FromString(content)


async def channels(port):
    for subprotocol in SUBPROTOCOLS:
        viewer = await Viewer(port).connect(subprotocol)
        await viewer.subscribe()
        decode = Decoder(viewer)
        await viewer.until(lambda: {"/robot", "/latencies"} <= viewer.messages.keys(), "robot and latencies")
        await viewer.read_for(3)
        robot = decode("/robot", viewer.messages["/robot"][0][1])
        names = lambda kind: [item if isinstance(item, str) else item["name"] for item in robot[kind]]
        expected = {f"/{topic}/{name}" for topic, kind in
                    [("joints", "joints"), ("indicators", "joints"), ("groups", "groups"), ("buses", "buses"), ("imus", "imus")]
                    for name in names(kind)}
        expected |= {"/cycle", "/events", "/robot", "/latencies", "/joint_states"}
        assert viewer.channels.keys() == expected, viewer.channels.keys() ^ expected
        assert names("joints") == JOINTS and len(viewer.messages["/robot"]) == 1
        count = 0
        for topic, messages in viewer.messages.items():
            for time_ns, content in messages:
                decode(topic, content)
                count += 1
                assert abs(time_ns - time.time_ns()) < 60e9, "the time of a message is no Unix time"
        # The MIT motors of this robot have no indicators; nothing happens for events.
        silent = {topic for topic in expected - viewer.messages.keys() if not topic.startswith("/indicators/")} - {"/events"}
        assert not silent, silent
        knee = decode("/joints/fl-knee", viewer.messages["/joints/fl-knee"][-1][1])
        assert knee.HasField("position") and -2.7 < knee.position < -0.5, knee
        states = decode("/joint_states", viewer.messages["/joint_states"][-1][1])
        assert [joint.name for joint in states.joints] == JOINTS and all(joint.HasField("effort") for joint in states.joints)
        assert decode("/groups/legs", viewer.messages["/groups/legs"][-1][1]).phase == "active"
        latencies = decode("/latencies", viewer.messages["/latencies"][-1][1])
        assert latencies["wake_latency_us"]["p99"] > 0 and [joint["name"] for joint in latencies["joints"]] == JOINTS
        schema = json.loads(viewer.schema("/latencies")[2])
        assert schema["properties"].keys() == latencies.keys(), schema
        await parameters(viewer)
        status = await viewer.call("/motord/status")
        assert status["groups"][0]["phase"] == "active" and len(status["joints"]) == 12, status
        await viewer.socket.close()
        print(f"  {subprotocol}: {len(expected)} channels, {count} messages decoded")
    for foreign in ["foxglove.websocket.v1", "foxglove.sdk.v2"]:
        try:
            await websockets.connect(f"ws://127.0.0.1:{port}", subprotocols=[foreign])
            raise AssertionError(foreign)
        except websockets.exceptions.InvalidStatus as refusal:
            assert refusal.response.status_code == 400


async def parameters(viewer):
    async def values(**request):
        viewer.texts.clear()
        await viewer.send(**request)
        answers = lambda: [text for text in viewer.texts if text["op"] == "parameterValues"]
        await viewer.until(answers, "parameter values")
        return {parameter["name"]: parameter["value"] for parameter in answers()[0]["parameters"]}

    known = await values(op="getParameters", parameterNames=[], id="all")
    assert "<robot" in known["/robot_description"] and known["/motord/joints/fl-knee/torque_max_nm"] == 20.0, known
    changed = [{"name": "/motord/joints/fl-knee/torque_max_nm", "value": 99.0}]
    assert list((await values(op="setParameters", parameters=changed, id="set")).values()) == [20.0]
    assert await values(op="getParameters", parameterNames=[], id="again") == known
    for number, (uri, is_served) in enumerate([("package://robot/hip.stl", True), ("package://../robot.urdf", False), ("file:///etc/passwd", False)]):
        await viewer.send(op="fetchAsset", uri=uri, requestId=number)
        await viewer.until(lambda: number in viewer.assets, "asset")
        assert (viewer.assets[number] == (0, b"mesh")) == is_served, viewer.assets


def check_rates(viewer, least, topics=None):
    """Each interval of a rate has at most one message; `least` of them have one. Returns the smallest part that has one."""
    decode, parts = Decoder(viewer), {}
    for topic in topics or viewer.channels:
        every = next((cycles for prefix, cycles in CYCLES.items() if topic.startswith(prefix)), None)
        if every is None:
            continue
        numbers = [decode(topic, content).cycle // every for _, content in viewer.messages[topic]]
        assert numbers, f"no message of {topic}"
        # A change of the group is sent out of turn.
        assert len(numbers) == len(set(numbers)) or topic in ("/groups/legs", "/cycle"), f"{topic} is sent too often"
        parts[topic] = len(set(numbers)) / (numbers[-1] - numbers[0] + 1)
        assert parts[topic] >= least, (topic, parts[topic])
    return min(parts.values())


async def rates(port, seconds):
    viewer = await Viewer(port).connect()
    await viewer.subscribe()
    await viewer.read_for(float(seconds))
    # This machine has other load: half of the intervals may pass without a turn of the bridge.
    part = check_rates(viewer, 0.5)
    count = lambda topic: len(viewer.messages[topic])
    print(f"  {seconds} s: {count('/joints/fl-hip')} of each joint, {count('/imus/base')} of the IMU, {count('/groups/legs')} of the group, "
          f"{count('/buses/rear-left')} of each bus; the worst topic has {100 * part:.1f} % of its messages")


def silent_viewer(port):
    """A viewer that subscribes to all and does not read; its kernel holds little."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    # The server reads nothing of a viewer that does not read its answers.
    connection.settimeout(1)
    connection.connect(("127.0.0.1", int(port)))
    key = base64.b64encode(os.urandom(16)).decode()
    connection.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
                       f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {SUBPROTOCOLS[1]}\r\n\r\n".encode())
    # Frames before the answer would end the handshake.
    answer = b""
    while not answer.endswith(b"\r\n\r\n"):
        answer += connection.recv(1)
    assert answer.startswith(b"HTTP/1.1 101"), answer
    return connection


def frame(opcode, content):
    """A masked frame of a client."""
    length = len(content)
    head = bytes([0x80 | opcode]) + (bytes([0x80 | length]) if length < 126 else bytes([0xFE]) + struct.pack(">H", length) if length < 65536
                                     else bytes([0xFF]) + struct.pack(">Q", length))
    return head + bytes(4) + content


def read_bytes(connection, seconds):
    """The bytes that arrive within this time."""
    data, end = b"", time.monotonic() + seconds
    connection.settimeout(0.2)
    while time.monotonic() < end:
        try:
            data += connection.recv(1 << 20)
        except TimeoutError:
            continue
    return data


def binary_messages(data):
    """The binary messages in what a server sent."""
    messages = []
    while len(data) > 10:
        length, start = data[1] & 127, 2
        if length == 126:
            length, start = struct.unpack_from(">H", data, 2)[0], 4
        elif length == 127:
            length, start = struct.unpack_from(">Q", data, 2)[0], 10
        if len(data) < start + length:
            break
        if data[0] & 15 == 2:
            messages.append(data[start:start + length])
        data = data[start + length:]
    return messages


async def watchers(port, seconds):
    first = await Viewer(port).connect(SUBPROTOCOLS[1])
    silent = silent_viewer(port)
    subscriptions = [{"id": channel["id"], "channelId": channel["id"]} for channel in first.channels.values()]
    silent.sendall(frame(1, json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()))
    # The server has to send its channels first.
    begin = read_bytes(silent, 3)
    viewers = [first] + [await Viewer(port).connect(SUBPROTOCOLS[1]) for _ in range(19)]
    # More topics would measure this Python.
    for viewer in viewers:
        await viewer.subscribe(["/joints/fl-hip", "/joint_states", "/groups/legs", "/cycle"])
    await asyncio.gather(*(viewer.read_for(float(seconds)) for viewer in viewers))
    parts = [check_rates(viewer, 0.5, ["/joints/fl-hip", "/groups/legs"]) for viewer in viewers]
    print(f"  20 viewers: {min(len(viewer.messages['/joints/fl-hip']) for viewer in viewers)} to "
          f"{max(len(viewer.messages['/joints/fl-hip']) for viewer in viewers)} messages of each joint, at least {100 * min(parts):.1f} %")
    decode, channel = Decoder(first), first.channels["/joints/fl-hip"]["id"]
    for viewer in viewers[1:]:
        await viewer.socket.close()
    # It reads now: old messages from the buffers, then the newest.
    received = binary_messages(begin + read_bytes(silent, 5))
    hips = [decode("/joints/fl-hip", message[13:]).cycle for message in received if message[0] == 1 and struct.unpack_from("<I", message, 1)[0] == channel]
    gap = max(b - a for a, b in zip(hips, hips[1:]))
    print(f"  the viewer that did not read: {len(received)} messages before, from the buffers and in the next 5 s; the largest gap {gap} cycles")
    assert gap > 1000, "nothing was dropped: the buffer of a viewer that does not read has no bound"
    assert hips == sorted(hips)
    silent.close()
    await first.socket.close()


async def ages(port):
    viewer, found = await Viewer(port).connect(), []
    for number in range(300):
        found.append((await viewer.call("/motord/status", number))["age_ms"])
        await asyncio.sleep(0.01)
    found.sort()
    print(f"  age of the newest state of the thread motor: p50 {found[150]:.1f}, p99 {found[297]:.1f} ms")
    await viewer.socket.close()


def idle_connections(port):
    """Connects until the server stops listening, since the bridge has no file descriptor left for a connection."""
    idle, end = [], time.monotonic() + 60
    while time.monotonic() < end:
        connection = socket.socket()
        connection.settimeout(1)
        try:
            connection.connect(("127.0.0.1", int(port)))
        except ConnectionRefusedError:
            connection.close()
            print(f"  {len(idle)} idle connections, then the server stopped listening")
            return idle
        except OSError:
            # The queue of the server is full.
            connection.close()
            continue
        if len(idle) < 600:
            idle.append(connection)
        else:
            connection.close()
    raise AssertionError("600 connections do not use up the file descriptors of the bridge")


async def when_it_listens(connect):
    """The connection, as soon as the server listens: where it closes connections slower than they come, it has no descriptor for a while."""
    end = time.monotonic() + 60
    while True:
        try:
            return connect()
        except ConnectionRefusedError:
            assert time.monotonic() < end, "the server does not listen any more"
            await asyncio.sleep(0.5)


async def connect_again(port):
    """A viewer that connects as soon as the server listens again."""
    end = time.monotonic() + 60
    while True:
        try:
            return await Viewer(port).connect()
        except (OSError, websockets.exceptions.WebSocketException):
            assert time.monotonic() < end, "no viewer can connect any more"
            await asyncio.sleep(0.5)


async def stop(port):
    viewer = await Viewer(port).connect()
    await viewer.subscribe(["/groups/legs", "/events"])
    # An event is the difference to a state of before.
    await viewer.until(lambda: viewer.messages["/groups/legs"], "state of the group")
    await stop_whole(viewer)
    decode = Decoder(viewer)
    is_stopped = lambda content: decode("/groups/legs", content).cause == "emergency-stop"
    await viewer.until(lambda: any(is_stopped(content) for _, content in viewer.messages["/groups/legs"]), "stopped group")
    texts = lambda: [decode("/events", content).message for _, content in viewer.messages["/events"]]
    await viewer.until(lambda: any("emergency stop" in text for text in texts()), "event")
    print(f"  events: {texts()}")
    await viewer.socket.close()


async def stop_whole(viewer):
    begun = time.monotonic()
    receipt = await viewer.call("/motord/stop")
    print(f"  after {1e3 * (time.monotonic() - begun):.1f} ms: {receipt}")
    assert receipt.get("confirmed") == JOINTS, receipt


async def starved(port):
    viewer = await Viewer(port).connect()
    # The stop needs no file descriptor that others can use up, and neither does the check of the motors.
    idle = idle_connections(port)
    await stop_whole(viewer)
    for connection in idle:
        connection.close()
    newcomer = await connect_again(port)
    # The server has another listener for the newcomer, and keeps those that were connected before.
    for each in (viewer, newcomer):
        await stop_whole(each)
        await each.socket.close()


async def leaves(port, log):
    stops = lambda: len(re.findall("emergency stop by the Foxglove viewer", pathlib.Path(log).read_text()))
    for seed in range(20):
        before, connection = stops(), silent_viewer(port)
        # The server has sent its channels: they stay unread, so that the kernel resets the connection when it is closed.
        data = b""
        while not (found := re.search(rb'"id":(\d+),"name":"/motord/stop"', data)):
            data += connection.recv(1 << 16)
        subscriptions = [{"id": number, "channelId": number} for number in map(int, re.findall(rb'"id":(\d+),"topic"', data))]
        connection.sendall(frame(1, json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()))
        # Without it the kernel may hold the stop, and drop it when the connection is closed: it would never have left the viewer.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Random: between no message and some that wait in the kernel.
        await asyncio.sleep(random.Random(seed).random() / 10)
        connection.sendall(frame(2, struct.pack("<BIII", 2, int(found[1]), 1, 4) + b"json{}"))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.close()
        end = time.monotonic() + 60
        while stops() == before:
            assert time.monotonic() < end, f"the stop of viewer {seed} that left was lost"
            await asyncio.sleep(0.01)
    print("  20 viewers stopped and left: each stop counted")


def damaged(seed):
    """What a hostile viewer sends after the handshake."""
    dice = random.Random(seed)
    texts = ["{", "[]", "null", '{"op":"subscribe"}', '{"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":-1}]}', '{"op":"setParameters","parameters":[{}]}',
             '{"op":"advertise","channels":[{"id":1,"topic":"/joints/fl-hip","encoding":"json","schemaName":""}]}', "[" * 60000, '{"op":"fetchAsset","uri":"package://../..","requestId":1}',
             json.dumps({"op": "subscribe", "subscriptions": [{"id": number, "channelId": number} for number in range(2000)]})]
    for _ in range(60):
        kind = dice.randrange(4)
        if kind == 0:
            yield frame(1, dice.choice(texts).encode())
        elif kind == 1:
            yield frame(2, bytes([dice.randrange(6)]) + dice.randbytes(dice.randrange(40)))
        elif kind == 2:
            yield frame(2, struct.pack("<BIII", 2, dice.randrange(100, 200), dice.randrange(10), dice.choice([4, 2**32 - 1])) + b"json{}")
        else:
            yield dice.randbytes(dice.randrange(1, 300))


async def hostile(port):
    for seed in range(200):
        dice = random.Random(seed)
        with await when_it_listens(lambda: socket.create_connection(("127.0.0.1", int(port)))) as connection:
            try:
                connection.sendall(dice.randbytes(dice.randrange(1, 4000)))
            except OSError:
                pass
    for seed in range(20):
        with await when_it_listens(lambda: silent_viewer(port)) as connection:
            try:
                for message in damaged(seed):
                    connection.sendall(message)
            except OSError:
                pass
    for connection in idle_connections(port):
        connection.close()
    viewer = await connect_again(port)
    status = await viewer.call("/motord/status")
    assert status["groups"][0]["phase"] == "active" and not status["emergency_stop"], status
    await viewer.socket.close()
    print("  the server answers, and the group is active")


async def files(path):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    counts = collections.Counter()
    with open(path, "rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=["/cycle", "/joints/fl-hip", "/groups/legs", "/imus/base", "/events", "/buses/rear-left"]):
            counts[channel.topic] += 1
            assert message.DESCRIPTOR.full_name.startswith(("motord.", "foxglove."))
    print(f"  mcap {dict(counts)}")
    assert counts["/cycle"] == counts["/joints/fl-hip"] > 0, counts


if __name__ == "__main__":
    asyncio.run({"channels": channels, "rates": rates, "watchers": watchers, "ages": ages, "stop": stop, "starved": starved, "leaves": leaves, "hostile": hostile, "files": files}[sys.argv[1]](*sys.argv[2:]))
