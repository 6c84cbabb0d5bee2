"""A movie: the flow uncontrolled above the same flow controlled, from one start, with drag and lift below."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manywake.case.task import Task
from manywake.env.control import ControlledFlows
from manywake.env.pictures import SPEED
from manywake.env.scene import FREE, TRACE, Scene, titled
from manywake.flow.baseline import Progress
from manywake.flow.store import Flow
from manywake.learn.controllers import Controller
from manywake.machine import disk

FRAMES = 8
"""About how many show a convective time L/U: three of these pass in a second."""
KINDS = (".mp4", ".gif")


@dataclass(frozen=True)
class Movie:
    """What was written. diverged: the controlled flow blew up, and the movie ends there."""

    path: Path
    frames: int
    diverged: bool


def checked(path: Path) -> Path:
    """Return the name of a film; ValueError where it is of no kind that can be written."""
    if path.suffix not in KINDS:
        raise ValueError(f"output: got {str(path)!r}, wanted a name that ends in {' or '.join(KINDS)}")
    return path


def movie(
    flow: Flow,
    task: Task,
    controller: Controller,
    path: Path,
    actions: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Movie:
    """Play an episode with a controller beside the uncontrolled one, and write it as .mp4 or .gif.

    actions: how many, an episode's when not given. seed: of the episode. ValueError for another kind of file.
    """
    checked(path)
    if actions is not None and actions < 1:
        raise ValueError(f"actions: got {actions}, wanted at least 1")
    count = actions or task.actions
    flows = ControlledFlows(flow, task, 2)
    flows.reset([0, 1], [seed, seed])
    choose, names = controller.on(flows), flow.baseline.shown
    scene = Scene(flow, count * task.interval)
    parts = min(max(1, round(FRAMES * task.interval / flow.case.convective_time)), flows.steps)
    controlled = np.array([[0.0], [1.0]])
    titles = f"uncontrolled, Re {flow.case.reynolds:g}", "controlled"
    traces: list[list[tuple[float, ...]]] = [[], []]
    frames, diverged = 0, False
    with _writer(path) as write:

        def seen(amplitudes: np.ndarray) -> None:
            nonlocal frames
            fields = [scene.field(flows.batch.state(b), amplitudes[:, b] / flows.limits) for b in (0, 1)]
            pictures = [titled(f, t, c) for f, t, c in zip(fields, titles, (FREE, TRACE), strict=True)]
            write(np.concatenate([*pictures, scene.strip(traces[1], traces[0])]))
            frames += 1

        seen(flows.amplitude)
        for t in range(count):
            outcome = flows.act(controlled * choose(t, flows.observe()), parts, seen)
            if diverged := bool(outcome.diverged.any()):
                break
            for b in (0, 1):
                traces[b].append(((t + 1) * task.interval, *(float(outcome.means[name][b]) for name in names)))
            if progress:
                progress(f"filming {path.name}", (t + 1) / count)
    return Movie(path, frames, diverged)


@contextmanager
def _writer(path: Path) -> Iterator[Callable[[np.ndarray], None]]:
    """Give what takes pictures (height, width, 3) uint8, in turn, into a file that is whole or not there."""
    with disk.begun(path) as name:
        if path.suffix == ".gif":
            kept: list[np.ndarray] = []
            yield kept.append
            _gif(kept, name)
        else:
            with _encoder(name) as write:
                yield write


@contextmanager
def _encoder(path: Path) -> Iterator[Callable[[np.ndarray], None]]:
    """Give what takes pictures into an MP4 file (H.264), by the ffmpeg of imageio-ffmpeg."""
    import imageio_ffmpeg

    made: list = []

    def write(picture: np.ndarray) -> None:
        if not made:
            height, width, _ = picture.shape
            kind = ["-f", "mp4"]  # the name does not tell
            made.append(
                imageio_ffmpeg.write_frames(
                    str(path), (width, height), fps=SPEED, macro_block_size=2, output_params=kind
                )
            )
            made[0].send(None)
        made[0].send(np.ascontiguousarray(picture).tobytes())

    try:
        yield write
    finally:
        for encoder in made:
            encoder.close()


def _gif(pictures: list[np.ndarray], path: Path) -> None:
    """Write every third picture, three quarters as large, in 48 colours that all share: it is for web pages."""
    from PIL import Image

    images = [Image.fromarray(picture) for picture in pictures[::3]]
    small = [image.resize((3 * image.width // 4, 3 * image.height // 4)) for image in images]
    colours = small[len(small) // 2].quantize(48)
    flat = [image.quantize(palette=colours, dither=Image.Dither.NONE) for image in small]
    flat[0].save(path, "GIF", save_all=True, append_images=flat[1:], duration=3000 // SPEED, loop=0, optimize=True)
