"""A peer without a claim: sends the robot frames that look right, and reads how they were counted.

    remote-forger.py ADDRESS

It knows the format, the run and the owner's lease, which each watcher sees. Prints the counters; fails where a frame was not counted, or a
sample was used.
"""

import json
import struct
import sys
import time

import zenoh

ROBOT = "motord/go7"
HEAD = "<IQQQ"
ECHO = "<QQQ"


def ask(session: zenoh.Session) -> dict:
    for reply in session.get(f"{ROBOT}/link", timeout=5.0):
        return json.loads(reply.ok.payload.to_bytes())
    raise SystemExit("no answer to link")


def newest(session: zenoh.Session) -> bytes:
    states = []
    with session.declare_subscriber(f"{ROBOT}/state", lambda sample: states.append(sample.payload.to_bytes())):
        end = time.monotonic() + 10
        while not states and time.monotonic() < end:
            time.sleep(0.01)
    if not states:
        raise SystemExit("no state")
    return states[-1]


def main() -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
    with zenoh.open(config) as session:
        time.sleep(1.0)
        before = ask(session)
        state = newest(session)
        layout, run, _, sent = struct.unpack_from(HEAD, state)
        echoes = struct.unpack_from("<I", state, 28)[0]
        start = 32 + 24 * echoes
        boot = struct.unpack_from("<Q", state, start)[0]

        def up(session_id: int, sequence: int, echo_run: int, echo_sent: int, at_ns: int = 1) -> bytes:
            return struct.pack(HEAD, layout, session_id, sequence, at_ns) + struct.pack(ECHO, echo_run, echo_sent, 0)

        def sample(time_ns: int, imu: int = 1) -> bytes:
            head = struct.pack("<QQQQII", boot, 1, 1, time_ns, imu, 0)
            return head + struct.pack("<11fI", 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81, 20.0, 0)

        def setpoint(lease: int) -> bytes:
            head = struct.pack("<QQQQII", lease, 1 << 20, 1, 0, 12, 0)
            return struct.pack("<Q", 0) + head + 12 * struct.pack("<5fI", 1.0, 0.0, 100.0, 1.0, 0.0, 1)

        def send(frame: bytes, key: str = "setpoint") -> None:
            session.put(f"{ROBOT}/{key}", frame)

        def fresh() -> int:
            return struct.unpack_from(HEAD, newest(session))[3]

        # Leases of the first claims of this daemon, with a fresh echo and numbers that rise.
        for number in range(1, 65):
            send(up(77, number, run, fresh() if number % 4 == 1 else sent) + setpoint((boot & 0xFFFFFFFF) << 32 | number << 8 | 1))
        send(up(77, 1, run, fresh()), "beat")
        send(up(77, 100, run, fresh() - 1_000_000_000), "beat")
        send(up(78, 1, run ^ 1, sent), "beat")
        send(up(79, 1, run, fresh())[:-3], "beat")
        send(struct.pack("<I", layout ^ 1) + b"\0" * 60)
        # Samples of an IMU: after their frame, a second before it, of an unknown IMU, in a captured frame, and none.
        second = 1_000_000_000
        send(up(81, 1, run, fresh(), second) + sample(second + 1), "imu")
        send(up(81, 2, run, fresh(), 2 * second) + sample(second), "imu")
        send(up(81, 3, run, fresh(), second) + sample(second, imu=9), "imu")
        send(up(81, 3, run, fresh(), second) + sample(second), "imu")
        send(up(82, 1, run ^ 1, sent) + sample(1), "imu")
        send(up(81, 4, run, fresh()), "imu")
        # Frames that ask for records, and are none.
        send(up(83, 1, run ^ 1, sent), "want")
        send(b"", "want")
        time.sleep(1.0)
        after = ask(session)
    counted = {reason: after["refused"][reason] - before["refused"][reason] for reason in after["refused"]}
    missing = [reason for reason in ("foreign", "late", "old", "unechoed", "malformed", "layout") if not counted[reason]]
    print(json.dumps(counted))
    if after["samples"] != before["samples"]:
        raise SystemExit("a sample was used")
    if missing:
        raise SystemExit(f"not counted: {missing}")


if __name__ == "__main__":
    main()
