"""Recordings of motorctl, of other programs, and cut-off ones."""

import os
import resource
import struct
from pathlib import Path

import numpy as np
import pytest

import motord
from conftest import Daemon, reset

pytest.importorskip("mcap_protobuf")
from mcap.writer import Writer  # noqa: E402


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture
def run(daemon: Daemon, robot: motord.Robot, folder: Path) -> Path:
    """A recording of 3 s: joints that move, a stop for a motor that is off, a lost IMU."""
    path = folder / "run.mcap"
    if path.exists():
        return path
    with daemon.recorder(path) as recorder:
        with pytest.raises(motord.Stopped), robot.claim("legs") as legs:
            legs.enable(hold=(40.0, 1.0))
            first = legs.wait()
            switched_off = False
            for state in legs.cycles(hz=500, timeout=5.0):
                time = state.time - first.time
                legs.send(q=first.q + 0.05 * np.sin(6.0 * min(time, 3.0)), kp=40.0, kd=1.0)
                if time > 1.0 and not switched_off:
                    daemon.motorctl("sim", "base", "off")
                    daemon.motorctl("sim", "fl-knee", "off")
                    switched_off = True
                assert time < 30.0, "a motor that is off stops the group"
        recorder.wait(60.0)
    daemon.motorctl("sim", "base", "ok")
    daemon.motorctl("sim", "fl-knee", "ok")
    for _ in range(20_000):
        if "offline" not in robot.wait().mode:
            break
    reset(robot)
    return path


def test_recording_gives_arrays_by_joint(run: Path) -> None:
    recording = motord.Recording(run)
    assert len(recording) > 2000 and recording.joints[2] == "fl-knee" and recording.damage is None
    assert recording.q.shape == recording.setpoint.q.shape == recording.applied.kp.shape == (len(recording), 12)
    assert recording.time[0] == 0.0 and (np.diff(recording.time) > 0).all() and recording.begun > 1e9
    assert np.median(np.diff(recording.time)) == pytest.approx(1e-3) and (np.diff(recording.cycle) > 0).all()
    hip = recording["fl-hip"]
    moving = np.isfinite(hip.setpoint.q) & (hip.setpoint.kp > 39.0)
    assert moving.sum() > 500 and np.ptp(hip.q[moving]) > 0.05
    error = hip.q[moving] - hip.setpoint.q[moving]
    assert np.sqrt(np.mean(error**2)) < 0.03
    with pytest.raises(KeyError, match="there is no joint 'tail'; there are fl-hip"):
        recording["tail"]
    with pytest.raises(ValueError):
        recording.q[0, 0] = 1.0


def test_stop_before_the_recording_is_none_of_it(daemon: Daemon, tmp_path: Path) -> None:
    robot = daemon.connect()
    robot.estop()
    path = tmp_path / "latched.mcap"
    with daemon.recorder(path, 1.0) as recorder:
        assert recorder.wait() == 0
    recording = motord.Recording(path)
    assert recording.stops == [] and len(recording.time) > 100
    reset(robot)


def test_recording_has_stops_imus_and_events(run: Path) -> None:
    recording = motord.Recording(run)
    stop = recording.stops[0]
    assert (stop.group, stop.cause, stop.joint) == ("legs", "motor-lost", "fl-knee") and stop.time > 0.5
    assert any("fl-knee" in event.text or "fl-knee" in event.name for event in recording.events)
    base = recording.imu["base"]
    assert base.orientation.shape == (len(base.time), 4) and len(base.time) > 200
    assert np.abs(np.linalg.norm(base.orientation, axis=1) - 1.0).max() < 1e-3
    assert base.acceleration[:, 2].mean() == pytest.approx(9.81, abs=0.5) and base.lost.any()


def test_cut_off_recording_is_refused_or_partial(run: Path, folder: Path) -> None:
    whole, cycles = run.read_bytes(), len(motord.Recording(run))
    for share in (0.2, 0.5, 0.9, 0.999):
        cut = folder / "cut.mcap"
        cut.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(motord.RecordingError, match=r"cut.mcap is cut off or damaged after \d+\.\d+ s"):
            motord.Recording(cut)
        recording = motord.Recording(cut, partial=True)
        assert recording.damage and len(recording) <= cycles
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 0xFF
    (folder / "damaged.mcap").write_bytes(damaged)
    with pytest.raises(motord.RecordingError, match="damaged.mcap is cut off or damaged after"):
        motord.Recording(folder / "damaged.mcap")


def write(path: Path, messages: dict[str, list[bytes]]) -> None:
    """Writes an MCAP file with JSON messages."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Text", "jsonschema", b"{}")
        for topic, texts in messages.items():
            channel = writer.register_channel(topic, "json", schema)
            for text in texts:
                writer.add_message(channel, 1, text, 1)
        writer.finish()  # type: ignore[no-untyped-call]


def test_foreign_files_are_refused(folder: Path) -> None:
    (folder / "text.mcap").write_text("time,q\n0,1\n")
    (folder / "empty.mcap").write_text("")
    for name in ("text.mcap", "empty.mcap"):
        with pytest.raises(motord.RecordingError, match=f"{name} is no recording: "):
            motord.Recording(folder / name)
    for topic, texts in (("/text", [b"{}"]), ("/robot", [b"[]"]), ("/robot", [b'{"joints": 3}'])):
        write(folder / "foreign.mcap", {topic: texts})
        with pytest.raises(motord.RecordingError, match="foreign.mcap is an MCAP file of another program"):
            motord.Recording(folder / "foreign.mcap")
    write(folder / "mixed.mcap", {"/robot": [b'{"joints": [{"name": "a"}]}'], "/joints/a": [b"[]"], "/cycle": [b"{}"]})
    with pytest.raises(motord.RecordingError, match="mixed.mcap: /cycle has messages of another program"):
        motord.Recording(folder / "mixed.mcap")
    with pytest.raises(motord.RecordingError, match="absent.mcap: there is no such file"):
        motord.Recording(folder / "absent.mcap")


def test_pipes_and_devices_are_no_recordings(folder: Path) -> None:
    os.mkfifo(folder / "pipe.mcap")
    with (folder / "huge.mcap").open("wb") as file:
        file.truncate(1 << 40)
    for path, text in (
        (folder / "pipe.mcap", "it is no regular file"),
        (Path("/dev/zero"), "it is no regular file"),
        (folder, "it is no regular file"),
        (folder / "huge.mcap", "it has 1048576 MiB; at most 65536 MiB are read"),
        (folder / "zero\0byte.mcap", r"zero.u\{0\}byte.mcap: embedded null byte"),
        (folder / "run.mcap" / "more", "Not a directory|there is no such file"),
    ):
        with pytest.raises(motord.RecordingError, match=text):
            motord.Recording(path)


MAGIC = b"\x89MCAP0\r\n"
ROBOT = b'{"joints": [{"name": "a"}]}'


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(data: bytes, size: int, compression: bytes) -> bytes:
    return record(6, struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(data)) + data)


def message(channel: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, 1, 1) + data)


def begin(topics: dict[bytes, bytes]) -> bytes:
    """The beginning of a file with channels of JSON."""
    channels = (
        record(4, struct.pack("<HH", at, 0) + text(topic) + text(b"json") + text(b""))
        for at, topic in enumerate([b"/robot", *topics], 1)
    )
    return MAGIC + record(1, text(b"") + text(b"")) + b"".join(channels)


def bombs() -> dict[str, bytes]:
    """Files that must end soon, whatever they declare."""
    import lz4.frame
    import zstandard

    zeros = zstandard.compress(bytes(1 << 28))
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 28))
    empty = record(0x80, b"") * ((16 << 20) // 9)
    small = zstandard.compress(empty)
    start = begin({}) + message(1, ROBOT)
    nested = b'{"joints": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    return {
        "declares a chunk": start + chunk(zeros, 1 << 60, b"zstd"),
        "hides its size": start + chunk(zeros, 1 << 20, b"zstd"),
        "has no size": start + chunk(unsized, 1 << 20, b"zstd"),
        "is of lz4": start + chunk(lz4.frame.compress(bytes(1 << 26)), 1 << 20, b"lz4"),
        "expands often": start + 40 * chunk(small, len(empty), b"zstd"),
        "declares a record": start + struct.pack("<BQ", 5, 1 << 60),
        "declares a text": start + record(4, struct.pack("<HHI", 9, 0, 0xFFFF_FFFF)),
        "declares data": start + record(6, struct.pack("<QQQIIQ", 0, 0, 9, 0, 0, 1 << 62)),
        "is sparse": start + bytes(1 << 20),
        "nests": begin({}) + message(1, nested),
        "has a number for a name": begin({}) + message(1, b'{"joints": [{"name": 3}]}'),
        "has no list": begin({}) + message(1, b'{"joints": [], "imus": 3}'),
        "has many joints": begin({}) + message(1, b'{"joints": [' + b",".join([b'{"name": "a"}'] * 65) + b"]}"),
        "has a late time": begin({b"/cycle": b""}) + message(1, b'{"joints": []}') + message(2, b'{"cycle": 1}'),
        "has another compression": start + chunk(b"", 0, b"snappy"),
        "has another channel": start + message(7, b""),
    }


def test_recording_bombs_end_by_a_limit(folder: Path) -> None:
    files = bombs()
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit = resource.getrlimit(resource.RLIMIT_AS)
    # Beyond what the process has: an allocation of a declared size fails.
    resource.setrlimit(resource.RLIMIT_AS, (now + (200 << 20), limit[1]))
    try:
        for name, content in files.items():
            path = folder / f"{name}.mcap"
            path.write_bytes(content)
            with pytest.raises(motord.RecordingError) as refused:
                motord.Recording(path)
            text = str(refused.value).replace(f"{folder}/", "")
            assert text.startswith(name) and "MemoryError" not in text, text
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limit)


def test_texts_of_recording_are_escaped(folder: Path) -> None:
    write(folder / "evil.mcap", {"/robot": [b'{"joints": [{"name": "a"}]}'], "/events/\x1b[31m\u202e": [b"{}"]})
    with pytest.raises(motord.RecordingError) as refused:
        motord.Recording(folder / "evil.mcap")
    assert str(refused.value).isprintable()


def test_frame_has_columns_by_joint(run: Path) -> None:
    pytest.importorskip("pandas")
    recording = motord.Recording(run)
    frame = recording.frame()
    assert frame["fl-knee", "q"].to_numpy() == pytest.approx(recording["fl-knee"].q, nan_ok=True)
    assert frame.index.name == "time" and ("rr-hip", "setpoint.kp") in frame.columns
