import cv2
import numpy as np
import pytest

from sim.video import VIDEO_WIDTHS, VideoEncoder, image_sample


def busy_picture(seed: int, *, size: tuple[int, int] = (960, 1280)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (size[0] // 16, size[1] // 16, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_LINEAR))


def test_an_image_keeps_its_colours_and_size() -> None:
    red = np.zeros((120, 160, 3), np.uint8)
    red[..., 0] = 200
    image = image_sample(red, camera="hc", stamp_ns=7)
    decoded = cv2.imdecode(np.frombuffer(image.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert decoded is not None
    assert decoded.shape == red.shape
    assert np.abs(decoded.astype(int) - red).max() < 6


@pytest.mark.parametrize("bit_s", [1.5e6, 2e6, 3e6])
def test_video_settles_within_its_budget(bit_s: float) -> None:
    video = VideoEncoder(camera="hc", bit_s=bit_s, rate_hz=25.0)
    sizes = [len(video.encode(busy_picture(i), stamp_ns=i).jpeg) for i in range(60)]
    assert np.mean(sizes[20:]) * 8 * 25 < 1.1 * bit_s


def test_video_is_small_and_an_empty_picture_gets_the_best_quality() -> None:
    video = VideoEncoder(camera="hc", bit_s=3e6, rate_hz=25.0)
    for i in range(40):
        sample = video.encode(np.zeros((960, 1280, 3), np.uint8), stamp_ns=i)
    decoded = cv2.imdecode(np.frombuffer(sample.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape == (480, VIDEO_WIDTHS[0], 3)
    assert video.quality == 85
