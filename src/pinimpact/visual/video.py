"""Videos of replays: GIF by Pillow, other formats by ffmpeg."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
import tempfile
from io import BytesIO
from pathlib import Path

import numpy as np

from ..checks import above_zero, finite_array, output_file, whole_number
from ..errors import InputError
from .browser import find_browser, open_page

COLORS = 128
"""Number of colours of a GIF that are most frequent, and of those that cover the range of colours."""
FILMS = (".mp4", ".webm", ".mkv", ".mov")
"""Formats written by ffmpeg."""


def write_video(
    page: str, path: str | Path, *, rate: float = 25.0, size: tuple[int, int] = (960, 540)
) -> Path:
    """Write a replay as a video.

    The frames are drawn by a headless browser (Chromium, Chrome or Edge). Without one, use the button "video"
    of the page in any browser.

    Args:
        page: The attribute ``html`` of a `Replay`.
        path: A path that ends in .gif, .mp4, .webm, .mkv or .mov, in a folder that exists.
        rate: Frames per second, > 0; at most 50 for a GIF.
        size: Width and height of the window, at least 1 [px].

    Returns:
        The path.

    Raises:
        InputError: Another ending, a missing folder, or no browser or ffmpeg on this machine.
    """
    path = output_file("path", path)
    width, height = (
        whole_number("size", n, 1) for n in finite_array("size", size, (2,)).astype(int).tolist()
    )
    rate = above_zero("rate", rate)
    kind = path.suffix.lower()
    if kind != ".gif" and kind not in FILMS:
        raise InputError(
            f"path: {path.name!r} given, a name that ends in .gif, {', '.join(FILMS)} expected", value=path
        )
    ffmpeg = shutil.which("ffmpeg")
    if kind in FILMS and ffmpeg is None:
        raise InputError(
            f"path: {path.name!r} given, but ffmpeg is not installed; install it, or write a .gif", value=path
        )
    browser = find_browser()
    if browser is None:
        raise InputError(
            "path: no Chromium, Chrome or Edge is installed to draw the frames; open the replay in a browser "
            'and press its button "video"',
            value=path,
        )
    if kind == ".gif":
        rate = min(rate, 50.0)
    frames = _frames(page, browser, rate, (width, height), "png" if kind == ".gif" else "jpeg")
    if kind == ".gif":
        _write_gif(frames, path, rate)
    else:
        assert ffmpeg is not None  # checked above
        _write_film(frames, path, rate, ffmpeg)
    return path


def _frames(text: str, browser: str, rate: float, size: tuple[int, int], kind: str) -> list[bytes]:
    """Return the frames as image files in the format `kind`."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        page.write_text(text, encoding="utf-8")
        opened = open_page(browser, page, f"frames={rate:.9g},{size[0]},{size[1]},{kind}", size=size)
    found = re.search(r'<pre id="frames">([^<]*)</pre>', opened.dom)
    if found is None:
        raise InputError(
            f"path: {Path(browser).name} drew no frames: {' '.join(opened.console[-3:]) or 'no message'}"
        )
    return [base64.b64decode(line) for line in found[1].split()]


def _write_gif(frames: list[bytes], path: Path, rate: float) -> None:
    from PIL import Image

    pictures = [Image.open(BytesIO(frame)).convert("RGB") for frame in frames]
    # one palette and no dither, so that each frame stores only the pixels that change
    some = pictures[:: max(1, len(pictures) // 6)]
    together = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for k, picture in enumerate(some):
        together.paste(picture, (0, k * picture.height))
    palette = Image.new("P", (1, 1))
    common, bright = (
        together.quantize(COLORS, m) for m in (Image.Quantize.MEDIANCUT, Image.Quantize.MAXCOVERAGE)
    )
    palette.putpalette([*(common.getpalette() or []), *(bright.getpalette() or [])])
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    # a GIF has whole hundredths of a second; those of the ends of all frames are rounded, so that none add up
    durations = 10 * np.diff(np.round(100.0 / rate * np.arange(len(pictures) + 1))).astype(int)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations.tolist(), loop=0)


def _write_film(frames: list[bytes], path: Path, rate: float, ffmpeg: str) -> None:
    read = f"-y -loglevel error -f image2pipe -framerate {rate:.9g} -c:v mjpeg -i -"
    even = "-vf scale=trunc(iw/2)*2:trunc(ih/2)*2 -pix_fmt yuv420p"
    command = [ffmpeg, *read.split(), *even.split(), str(path)]
    done = subprocess.run(command, input=b"".join(frames), capture_output=True)
    if done.returncode:
        raise InputError(f"path: ffmpeg: {done.stderr.decode('utf-8', 'replace').strip()}", value=path)
