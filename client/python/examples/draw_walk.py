"""Draws the quadruped that walks in a twin: a GIF. Needs pillow and a software renderer, such as libosmesa6.

    MUJOCO_GL=osmesa python draw_walk.py docs/walk.gif
"""

import sys
from typing import Any

import mujoco
from PIL import Image
from walk import CONFIG, MODEL, walk

from motord.sim import Mujoco, Twin

FRAME_S = 0.1
WIDTH, HEIGHT = 400, 225
BEGIN_S, END_S = 1.6, 4.8


class Filmed(Mujoco):
    """Keeps a frame every FRAME_S."""

    def __init__(self) -> None:
        super().__init__(MODEL, imu="imu", key="stand")
        self.frames: list[Any] = []
        self._renderer: Any = None

    def step(self, torques: Any, seconds: float, q: Any, dq: Any) -> None:
        super().step(torques, seconds, q, dq)
        time = self.data.time
        if BEGIN_S <= time < END_S and time >= BEGIN_S + FRAME_S * len(self.frames):
            self._renderer = self._renderer or mujoco.Renderer(self.model, HEIGHT, WIDTH)
            self._renderer.update_scene(self.data, camera="side")
            self.frames.append(self._renderer.render())


def main() -> None:
    plant = Filmed()
    walk(Twin(CONFIG, plant, compute_us=300, seed=1), END_S)
    images = [Image.fromarray(frame).quantize(32) for frame in plant.frames]
    images[0].save(sys.argv[1], save_all=True, append_images=images[1:], duration=round(1000 * FRAME_S), loop=0, optimize=True)


if __name__ == "__main__":
    main()
