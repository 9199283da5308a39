"""Many runs of a controller on the twin: the same rows in each process, and a row for each failure."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import CONFIG, Daemon

import motord
from motord.sim import Plan, Sweep, sweep
from motord.sim.delays import profile

PROGRAM = """
import os, random, sys
import numpy as np
import motord

robot = motord.connect("robot")
with robot.claim("legs") as legs:
    legs.enable(hold=(20.0, 0.5))
    first = legs.wait()
    for state in legs.cycles(hz=500):
        legs.send(q=first.q + 0.01 * (random.random() + np.random.random()), kp=20.0, kd=0.5)
        if state.time - first.time > 0.2:
            break
    for what in sys.argv[1:]:
        exec(what)
"""

LOSSES = [(0.0, "fl-knee", "intermittent 20%")]
"""With them each seed has another run."""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "controller.py"
    path.write_text(PROGRAM)
    return path


def plan(program: Path, *lines: str, **others: Any) -> Plan:
    return Plan(str(program), str(CONFIG), arguments=list(lines), **others)


ONE = """
import json, sys
from motord.sim import Plan
from motord.sim._run import run
print(json.dumps(run(Plan(**json.loads(sys.argv[1])), int(sys.argv[2]), 300.0)))
"""


def hashes(found: Sweep) -> list[str]:
    assert [row["result"] for row in found.runs] == ["passed"] * len(found.runs), found.table()
    return [row["hash"] for row in found.runs]


def test_one_seed_has_one_hash_anywhere(program: Path) -> None:
    chosen = plan(program, faults=LOSSES)
    found = sweep(chosen, range(1, 5), workers=2)
    known = hashes(found)
    assert len(set(known)) == 4 and all(len(one) == 64 for one in known)
    again = sweep(chosen, range(1, 5), workers=1)
    assert (hashes(again), again.hash) == (known, found.hash)
    # A process without workers, with other hashes of texts and other instructions in numpy's loops.
    environment = {**os.environ, "PYTHONHASHSEED": "7", "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512_SKX", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", ONE, json.dumps(chosen.__dict__), "3"]
    alone = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert alone.returncode == 0, alone.stderr
    assert json.loads(alone.stdout)["hash"] == known[2]


def test_ray_has_hashes_of_workers(program: Path) -> None:
    pytest.importorskip("ray")
    chosen = plan(program, faults=LOSSES)
    assert hashes(sweep(chosen, range(1, 5), workers=2, ray=True)) == hashes(sweep(chosen, range(1, 5), workers=2))


def test_delay_and_seed_change_a_run(program: Path) -> None:
    found = sweep(plan(program, faults=LOSSES), [7, 8], [0.0, 1500.0])
    assert [(row["delay_us"], row["seed"]) for row in found.runs] == [(0.0, 7), (0.0, 8), (1500.0, 7), (1500.0, 8)]
    assert len(set(hashes(found))) == 4
    assert found.passed == 4 and found.versions[0]["motord"]


@pytest.mark.parametrize(
    ("line", "result", "reason"),
    [
        ("os.kill(os.getpid(), 11)", "crashed", "signal SIGSEGV"),
        ("print('it leaves', flush=True); os._exit(3)", "crashed", "exit status 3: it leaves"),
        ("{}['a key']", "failed", "KeyError: 'a key'"),
        ("sys.exit(4)", "failed", "exit status 4"),
        ("sys.exit('hold: it ends')", "failed", "hold: it ends"),
        ("while True: pass", "hung", "no end within 2 s"),
        ("raise BaseException('\\x1b[2J')", "failed", "BaseException: \\u{1b}[2J"),
    ],
)
def test_failing_controller_has_a_row(program: Path, line: str, result: str, reason: str) -> None:
    found = sweep(plan(program, line, timeout=2.0 if result == "hung" else 600.0), [1, 2])
    assert [(row["result"], row["reason"]) for row in found.runs] == [(result, reason)] * 2
    assert f"0 of 2 passed; 2 {result}: {reason}" in found.table() and found.passed == 0
    assert found.summary()["counts"][result] == 2


@pytest.mark.parametrize("kind", ["without_connect", "no_python"])
def test_program_without_robot_has_a_row(program: Path, kind: str) -> None:
    text, reason = {"without_connect": ("1", "never called motord.connect"), "no_python": ("(", "SyntaxError")}[kind]
    program.write_text(text)
    (row,) = sweep(plan(program), [1]).runs
    assert row["result"] == "failed" and reason in row["reason"]


@pytest.mark.parametrize("end", ["", "except motord.Error: sys.exit('stopped')", "except motord.Error: pass"])
def test_stop_has_cause_and_joint(program: Path, end: str) -> None:
    loop = "for _ in legs.cycles(): legs.send(q=first.q, kp=20.0, kd=0.5)"
    lines = f"try:\n    {loop}\n{end}" if end else loop
    found = sweep(plan(program, lines, faults=[(0.5, "fl-knee", "off")]), [1])
    (row,) = found.runs
    assert (row["result"], row["cause"], row["joint"]) == ("stopped", "motor-lost", "fl-knee")
    assert "1 motor-lost of fl-knee" in found.table()


def test_endless_controller_passes_after_seconds(program: Path) -> None:
    endless = "while True:\n    try:\n        legs.send(q=first.q, kp=20.0, kd=0.5); legs.wait()\n    except Exception: pass"
    (row,) = sweep(plan(program, endless, seconds=1.0), [1]).runs
    assert row["result"] == "passed" and 1.0 <= row["seconds"] < 2.0
    assert row["worst_joint"] in row["errors_rad"] and row["worst_error_rad"] == max(row["errors_rad"].values())


def test_robot_that_fell_has_a_row(program: Path) -> None:
    pytest.importorskip("mujoco")
    from motord.examples import FILES, MODEL

    limp = "while True: legs.send(kd=0.1); legs.wait()"
    body = {"model": str(FILES / MODEL), "imu": "imu", "key": "stand", "fallen_below": 0.15}
    (row,) = sweep(plan(program, limp, **body), [1]).runs
    assert row["result"] == "fell" and row["seconds"] < 10.0


def test_files_that_differ_are_named(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motord.sim._run.Plan.files", lambda self: {self.controller: "another", self.config: "another"})
    (row,) = sweep(plan(program), [1]).runs
    assert row["result"] == "failed" and f"{program}, {CONFIG} differs on" in row["reason"]


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"controller": "none.py"}, "none.py: No such file"),
        ({"config": "none.toml"}, "none.toml: No such file"),
        ({"faults": [(1.0, "nobody", "off")]}, "nobody off: no bus or motor"),
    ],
)
def test_plan_that_fits_no_robot_is_refused(program: Path, change: dict[str, Any], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        sweep(Plan(**{**plan(program).__dict__, **change}), [1])
    with pytest.raises(ValueError, match="a number of µs"):
        sweep(plan(program), [1], [float("nan")])


def command(folder: Path, *arguments: str, text: str = "") -> "subprocess.CompletedProcess[str]":
    line = [sys.executable, "-m", "motord.sim", *arguments]
    return subprocess.run(line, capture_output=True, text=True, cwd=folder, input=text)


def test_command_prints_table_and_json(program: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(CONFIG.read_text())
    line = ("sweep", program.name, "--seeds", "2", "--first-seed", "5", "--delays", "0,300")
    done = command(tmp_path, *line)
    assert done.returncode == 0 and "delay 300 µs: 2 of 2 passed" in done.stdout, done.stderr
    assert "4 of 4 runs, 0 not passed" in done.stderr
    done = command(tmp_path, *line, "--json", "--", "sys.exit(1)")
    rows = json.loads(done.stdout)["runs"]
    assert done.returncode == 1 and [row["seed"] for row in rows] == [5, 6, 5, 6], done.stderr


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_command_draws_a_picture(program: Path, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / f"sweep.{kind}"
    line = ("sweep", program.name, "--config", str(CONFIG), "--seeds", "2", "--picture", str(picture))
    assert command(tmp_path, *line).returncode == 0
    assert picture.read_bytes()[:5] == {"svg": b"<?xml", "png": b"\x89PNG\r"}[kind]


def latencies(edit: Callable[[dict[str, Any]], Any] = lambda found: None) -> str:
    def of(p50: float, p99: float) -> dict[str, float]:
        return {"count": 100, "p50": p50, "p99": p99, "p99_9": p99, "max": p99}

    groups: list[dict[str, Any]] = [{"name": "legs", "control_latency_us": of(5200, 9000), "cycles": [0, 0, 50, 50]}]
    groups += [{"name": "arm", "control_latency_us": {**of(0, 0), "count": 0}, "cycles": []}]
    found = {"instance": "demo", "cycle_us": of(700, 800), "reply_latency_us": of(500, 600), "control": groups}
    edit(found)
    return json.dumps(found)


def test_profile_has_milliseconds_and_lags() -> None:
    found = profile(latencies(), 5.0)
    (legs,) = found["groups"]
    assert legs["control_ms"] == {"p50": 5.2, "p99": 9.0, "p99_9": 9.0, "max": 9.0} and legs["setpoints"] == 100
    assert legs["observation_age_ms"]["p99"] == 0.8 and legs["command_ms"]["p99"] == 0.6
    # 5.2 ms, and at most 9 + 0.8 + 0.6 ms, in steps of 5 ms.
    assert legs["lag_steps"] == {"min": 1, "max": 3}


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "one object of motorctl latency --json"),
        ("[]", "one object of motorctl latency --json"),
        (latencies(lambda found: found.pop("cycle_us")), "KeyError: 'cycle_us'"),
        (latencies(lambda found: found["control"].pop(0)), "no setpoint answered a state"),
    ],
)
def test_other_texts_have_no_profile(text: str, part: str) -> None:
    with pytest.raises(ValueError, match=part):
        profile(text, 5.0)


def test_command_writes_the_delays(tmp_path: Path) -> None:
    done = command(tmp_path, "delays", "-", "--step-ms", "5", text=latencies())
    assert done.returncode == 0 and json.loads(done.stdout)["step_ms"] == 5.0, done.stderr
    (tmp_path / "latency.json").write_text(latencies())
    assert command(tmp_path, "delays", "latency.json", "--step-ms", "5", "--output", "delays.json").returncode == 0
    assert json.loads((tmp_path / "delays.json").read_text()) == json.loads(done.stdout)
    assert "there is no such file" in command(tmp_path, "delays", "none.json", "--step-ms", "5").stderr


def test_latencies_of_a_daemon_have_profile(daemon: Daemon, robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable(hold=(20.0, 0.5))
        first = legs.wait()
        for _, state in zip(range(200), legs.cycles(hz=200), strict=False):
            assert state.stop is None
            legs.send(q=first.q, kp=20.0, kd=0.5)
    (found,) = profile(daemon.motorctl("latency", "--json"), 5.0)["groups"]
    assert found["name"] == "legs" and found["setpoints"] >= 190 and found["lag_steps"]["max"] >= 1
