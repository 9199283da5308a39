"""Recordings of motorctl, of other programs, and cut-off ones."""

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
    assert len(recording) > 2000 and recording.names[2] == "fl-knee" and recording.damage is None
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
    with pytest.raises(FileNotFoundError):
        motord.Recording(folder / "absent.mcap")


def test_frame_has_columns_by_joint(run: Path) -> None:
    pytest.importorskip("pandas")
    recording = motord.Recording(run)
    frame = recording.frame()
    assert frame["fl-knee", "q"].to_numpy() == pytest.approx(recording["fl-knee"].q, nan_ok=True)
    assert frame.index.name == "time" and ("rr-hip", "setpoint.kp") in frame.columns
