"""Reads every state of the robot `demo` while the stacks of docs/stacks.md drive it.

SIGUSR1 begins a stack, and SIGUSR2 ends it. Prints a line for each stack, and one for the time from the end of the stack before.
"""

import signal
import sys
import time

import numpy as np

import motord

# 0.15 rad/s are 0.00015 rad in a cycle, and one code of a motor is 0.00038 rad.
STEP_MAX = 0.002
MOVED_MIN = 0.01


class Watch:
    def __init__(self, state):
        self.begin(state)

    def begin(self, state):
        self.low, self.high, self.step, self.count = state.q.copy(), state.q.copy(), 0.0, 0
        self.begun, self.driven = time.monotonic(), None

    def add(self, before, state):
        self.step = max(self.step, np.abs(state.q - before.q).max() / max(state.cycle - before.cycle, 1))
        self.low, self.high = np.minimum(self.low, state.q), np.maximum(self.high, state.q)
        self.count += 1
        if self.driven is None and (self.high - self.low).max() > MOVED_MIN:
            self.driven = time.monotonic() - self.begun
            print("driven", flush=True)

    def report(self, drives):
        moved = self.high - self.low
        joints = "each joint" if moved.min() > MOVED_MIN else "joints"
        good = self.step < STEP_MAX and (self.driven is not None) == drives
        after = f", driven after {self.driven:.0f} s" if self.driven is not None else ""
        verdict = "good" if good else "FAILED"
        span = f"{joints} moved {moved.min():.3f} to {moved.max():.3f} rad"
        print(f"largest step {self.step:.6f} rad, {span}{after}, {self.count} states: {verdict}", flush=True)


def main():
    signals = []
    for number in (signal.SIGUSR1, signal.SIGUSR2):
        signal.signal(number, lambda number, _: signals.append(number))
    # A machine with other load may delay the daemon.
    robot = motord.connect("demo")
    before = robot.wait(30.0)
    watch = Watch(before)
    print("watching", flush=True)
    while True:
        state = robot.wait(30.0)
        watch.add(before, state)
        before = state
        if signals:
            # The time between two stacks moves nothing.
            watch.report(drives=signals.pop(0) == signal.SIGUSR2)
            watch.begin(state)


if __name__ == "__main__":
    sys.exit(main())
