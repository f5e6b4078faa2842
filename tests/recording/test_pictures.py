import io

import numpy as np
import pytest

from vrcaps.recording.episode import read_episode
from vrcaps.recording.pictures import Preview, contact_sheet, limits_of, picture
from vrcaps.render.channels import CHANNELS

FRONT = (
    "foreground_label",
    "foreground_instance",
    "foreground_depth",
    "refraction_label",
    "dome_label",
)


@pytest.mark.parametrize("channel", [name for name in CHANNELS if name not in FRONT])
def test_every_channel_has_a_picture(recorded, channel):
    episode = read_episode(recorded)
    images = [episode.image("front", channel, frame) for frame in range(len(episode))]
    shown = picture(channel, images[1], limits_of(channel, images))
    assert shown.shape == (36, 40, 3)
    assert shown.dtype == np.uint8
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 1


@pytest.mark.parametrize("channel", FRONT)
def test_what_is_in_front_has_a_picture(channel):
    values = np.array([[0.0, 1.0, 2.0]], np.float32)
    values = values * 0.01 if channel == "foreground_depth" else values.astype(np.uint8)
    shown = picture(channel, values, limits_of(channel, [values]))
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) == 3


def test_depth_picture_runs_from_blue_to_red():
    values = np.array([[0.01, 0.05, np.nan]], np.float32)
    near, far, none = picture("depth", values, limits_of("depth", [values]))[0].astype(int)
    assert near[2] > near[0]
    assert far[0] > far[2]
    assert none.max() < 40


def test_limits_of_nothing():
    assert limits_of("depth", [np.full((2, 2), np.nan, np.float32)]) == (0.0, 1.0)


def test_contact_sheet_has_a_row_per_camera_and_channel(recorded):
    sheet = contact_sheet(read_episode(recorded))
    assert sheet.shape[0] > 2 * len(CHANNELS) * 160
    assert sheet.std() > 10.0


def test_preview_plays_back_and_repeats():
    """One thread: the same pictures give the same bytes; odd sizes are padded."""
    import av

    rng = np.random.default_rng(0)
    pictures = [np.full((31, 33, 3), value, np.uint8) for value in rng.integers(0, 255, 12)]
    films = []
    for _ in range(2):
        film = Preview(fps=2.5, width=66, height=31)
        for shown in pictures:
            film.add([shown, shown])
        films.append(film.finish())
    assert films[0] == films[1]
    with av.open(io.BytesIO(films[0])) as container:
        assert float(container.streams.video[0].average_rate) == pytest.approx(2.5)
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(frames) == 12
    assert frames[0].shape == (32, 66, 3)
    error = [
        abs(float(f[8:24, 8:56].mean()) - p.mean()) for f, p in zip(frames, pictures, strict=True)
    ]
    assert max(error) < 8.0
