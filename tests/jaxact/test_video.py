import subprocess
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from jaxact.errors import JaxactError
from jaxact.video import annotate, write_video

NAMES = ("left", "right", "forward")


def draw(frame: np.ndarray, **changes: Any) -> np.ndarray:
    arguments: dict[str, Any] = {
        "action_names": NAMES,
        "action_probabilities": np.array([0.2, 0.1, 0.7]),
        "chosen": [2],
        "value": 0.5,
        "reward": 0.0,
        "episode_return": 1.0,
        "step": 3,
        "mission": "go to the red ball",
    }
    return annotate(frame, **(arguments | changes))


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, shape, np.uint8)


def test_panel_is_beside_the_frame_and_sizes_are_even_and_constant() -> None:
    frame = noise(401, 355, 3)
    image = draw(frame)
    assert image.dtype == np.uint8
    assert np.array_equal(image[:401, :355], frame)
    assert image.shape[0] % 2 == image.shape[1] % 2 == 0
    for mission in (None, "word " * 100, "w" * 500):
        assert draw(frame, mission=mission, value=-1e6).shape == image.shape


def test_small_frames_are_enlarged_and_bars_grow() -> None:
    low, high = (draw(noise(8, 8, 3), action_probabilities=[0.0, 0.0, p]) for p in (0.1, 0.9))
    assert low.shape[0] >= 320
    assert np.sum(high == (255, 176, 59)) > np.sum(low == (255, 176, 59))
    assert draw(noise(8, 8, 3), action_names=(), action_probabilities=()).shape[0] >= 320


def decode(path: Path, height: int, width: int) -> np.ndarray:
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path)]
    raw = [*command, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = subprocess.run(raw, capture_output=True, check=True).stdout
    return np.frombuffer(pixels, np.uint8).reshape(-1, height, width, 3)


def test_videos_can_be_read_back(tmp_path: Path) -> None:
    frames = np.stack([np.full((33, 47, 3), 25 * t, np.uint8) for t in range(10)])
    write_video(tmp_path / "new" / "a.gif", frames, fps=5)
    with Image.open(tmp_path / "new" / "a.gif") as gif:
        assert gif.n_frames == 10
        assert gif.size == (47, 33)
        assert gif.info["duration"] == 200
    write_video(tmp_path / "a.mp4", list(frames))
    film = decode(tmp_path / "a.mp4", 34, 48)
    assert len(film) == 10
    assert np.abs(film[:, 5, 5, 0].astype(int) - 25 * np.arange(10)).max() < 12


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(JaxactError, match=r"has to end in \.gif or \.mp4"):
        write_video(tmp_path / "a.avi", noise(2, 8, 8, 3))
    with pytest.raises(JaxactError, match="at least one frame"):
        write_video(tmp_path / "a.gif", [])
    with pytest.raises(JaxactError, match="frames of one shape"):
        write_video(tmp_path / "a.gif", [noise(8, 8, 3), noise(8, 9, 3)])
    with pytest.raises(JaxactError, match=r"expected a frame uint8\[H, W, 3\], but got float32"):
        write_video(tmp_path / "a.gif", np.zeros((2, 8, 8, 3), np.float32))
    with pytest.raises(JaxactError, match="each of 3 actions, but got 2"):
        draw(noise(8, 8, 3), action_probabilities=[0.5, 0.5])
