"""Preview functions without a scene: time positions, loudness and images."""

from __future__ import annotations

from colorsys import rgb_to_hsv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_blender.preview import stroke_image
from hnf_blender.preview.sound_device import (
    FULL_SCALE_M_S2,
    apply_monitor_gain,
    compute_clipping_db,
    compute_monitor_gain,
)
from hnf_blender.preview.stroke_image import (
    ACTION_ROWS,
    DARK,
    FRAME_PX,
    LABEL_ROWS,
    LIGHT,
    PLAYHEAD_PX,
    SIZE_PX,
    SPECTROGRAM_ROWS,
    WAVE_ROWS,
    Ghost,
    ImageStyle,
    compute_column_extrema,
    draw_playhead,
    draw_stroke_image,
    find_column,
    find_on_screen,
    rasterise_text,
    round_up_nicely,
)
from hnf_blender.preview.timeline_playback import FrameClock, PlacedSignal, has_jumped, mix_strokes
from hnf_blender.state.interface import to_bytes
from hnf_core.action.action import Action
from hnf_core.export.figure import FORCE_COLOUR, SPEED_COLOUR
from hnf_core.signal import Signal

RATE = 10_000.0
CLOCKS = st.builds(FrameClock, st.sampled_from([24.0, 25.0, 30.0, 60.0]), st.sampled_from([1.0, 1.001]))


def ramp(count: int) -> np.ndarray:
    return np.arange(1, count + 1, dtype=np.float32)


@given(CLOCKS, st.floats(-100.0, 300.0), st.floats(-100.0, 300.0))
def test_a_frame_and_its_offset_are_the_same_place(clock, start, frame) -> None:
    seconds = clock.seconds(frame, start)
    assert start + seconds * clock.fps / clock.fps_base == pytest.approx(frame, abs=1e-9)


@given(CLOCKS, st.floats(0.0, 60.0), st.floats(0.0, 60.0))
@settings(max_examples=50)
def test_a_stroke_is_joined_where_the_timeline_stands(clock, start, frame) -> None:
    """Sample k of the mix is what the stroke holds at that moment, sub-frame starts included."""
    samples = ramp(8000)
    mixed = mix_strokes([PlacedSignal(start, samples, RATE)], frame, 1000.0, clock)
    first = round(clock.seconds(start, frame) * RATE)
    assert len(mixed) == max(first + len(samples), 0)
    expected = np.zeros(max(first, 0), dtype=np.float32)
    expected = np.concatenate([expected, samples[max(-first, 0) :]])
    assert np.array_equal(mixed, expected)


def test_strokes_add_and_the_last_frame_ends_all() -> None:
    clock = FrameClock(10.0)
    two = [PlacedSignal(1.0, ramp(5000), RATE), PlacedSignal(2.0, ramp(5000), RATE)]
    mixed = mix_strokes(two, 1.0, 1000.0, clock)
    assert mixed[1500] == 1501 + 501
    assert np.array_equal(mix_strokes(two, 1.0, 3.0, clock), mixed[:3000])
    assert len(mix_strokes(two, 50.0, 1000.0, clock)) == 0
    assert len(mix_strokes([], 1.0, 10.0, clock)) == 0


def test_strokes_of_several_rates_are_refused() -> None:
    with pytest.raises(ValueError, match="several sample rates"):
        mix_strokes([PlacedSignal(1.0, ramp(5), RATE), PlacedSignal(1.0, ramp(5), 8000.0)], 1.0, 2.0, FrameClock(24.0))


def test_a_jump_is_told_from_a_late_frame() -> None:
    clock = FrameClock(24.0)
    assert not has_jumped(25.0, 1.0, 1.0, clock)
    assert not has_jumped(25.0, 1.0 + 1.0 / 24.0, 1.0, clock)
    assert has_jumped(60.0, 1.0, 1.0, clock)
    assert has_jumped(2.0, 1.0, 1.0, clock)


@given(st.floats(-60.0, 60.0), st.floats(0.0, 500.0))
def test_the_monitor_is_a_gain_and_nothing_else(gain, level) -> None:
    samples = np.array([level, -level, 0.0], dtype=np.float32)
    heard = apply_monitor_gain(samples, gain)
    assert heard.shape == (3, 1)
    over = compute_clipping_db(level, gain)
    if over == 0.0:
        assert heard[:, 0] == pytest.approx(samples * compute_monitor_gain(gain), rel=1e-5, abs=1e-9)
    else:
        assert np.abs(heard).max() == 1.0
        assert level * compute_monitor_gain(gain - over) == pytest.approx(1.0)


def test_monitor_gain_puts_one_m_s2_20_db_below_full_scale() -> None:
    assert 20.0 * np.log10(compute_monitor_gain(0.0)) == pytest.approx(-20.0)
    assert compute_monitor_gain(0.0) * FULL_SCALE_M_S2 == 1.0


@given(st.integers(0, 5000), st.integers(1, 600), st.integers(0, 2**31))
@settings(max_examples=40)
def test_no_peak_is_lost_at_any_width(count, columns, seed) -> None:
    samples = np.random.default_rng(seed).standard_normal(count).astype(np.float32)
    low, high = compute_column_extrema(samples, columns)
    assert low.shape == high.shape == (columns,)
    if count:
        assert (low.min(), high.max()) == (samples.min(), samples.max())
        assert (low <= high).all()


@given(st.floats(1e-9, 1e9))
def test_scales_are_round_and_just_above(value) -> None:
    nice = round_up_nicely(value)
    assert value <= nice * (1.0 + 1e-9)
    assert nice <= 2.5 * value * (1.0 + 1e-9)
    assert float(f"{nice:.3e}"[0]) in (1, 2, 5)


def tone(frequency: float, peak: float = 2.0, seconds: float = 1.0) -> Signal:
    time = np.arange(int(seconds * RATE)) / RATE
    return Signal((peak * np.sin(2.0 * np.pi * frequency * time)).astype(np.float32), RATE, 0)


def hand(count: int = 201) -> Action:
    force = np.linspace(0.0, 1.5, count)
    speed = np.full(count, 0.1)
    return Action(200.0, np.tile([1.0, 0.0], (count, 1)), speed, force, np.arange(count) * 5e-4, force > 0.0)


@pytest.mark.parametrize("theme", [DARK, LIGHT])
def test_force_and_speed_have_the_hues_of_a_strokes_picture(theme) -> None:
    for own, other in ((theme.force, FORCE_COLOUR), (theme.speed, SPEED_COLOUR)):
        printed = tuple(int(other[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
        assert abs(rgb_to_hsv(*own)[0] - rgb_to_hsv(*printed)[0]) < 8.0 / 360.0


@pytest.mark.parametrize("theme", [DARK, LIGHT])
@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize("seconds", [0.0, 0.005, 1.0, 60.0])
def test_any_stroke_has_a_picture(theme, logarithmic, seconds) -> None:
    picture = draw_stroke_image(tone(200.0, seconds=seconds), hand(), ImageStyle(theme, 3.0, logarithmic))
    assert picture.shape == (SIZE_PX, SIZE_PX, 4)
    assert picture.dtype == np.float32
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0
    assert (picture[..., 3] == 1.0).all()


def test_a_tone_is_bright_at_its_frequency() -> None:
    for frequency, logarithmic in ((150.0, False), (700.0, False), (150.0, True)):
        picture = draw_stroke_image(tone(frequency), hand(), ImageStyle(DARK, None, logarithmic))[::-1]
        track = picture[slice(*SPECTROGRAM_ROWS), 200:300, :3].mean(axis=(1, 2))
        up = 1.0 - track[20:].argmax() / (len(track) - 1) - 20 / (len(track) - 1)
        found = 20.0 * 50.0**up if logarithmic else 1000.0 * up
        assert found == pytest.approx(frequency, rel=0.15)


def test_the_limit_is_drawn_where_it_lies() -> None:
    """A limit of 1 m/s² on a scale of 2 m/s²: a quarter and three quarters down; none, where it is beyond the scale."""
    look = np.array(DARK.limit, dtype=np.float32)

    def rows(limit):
        track = draw_stroke_image(tone(200.0, peak=1.9), hand(), ImageStyle(DARK, limit))[::-1][slice(*WAVE_ROWS)]
        return np.flatnonzero(
            (np.abs(track[:, FRAME_PX : FRAME_PX + 8, :3] - look).max(axis=2) < 1e-6).sum(axis=1) >= 4
        )

    height = WAVE_ROWS[1] - WAVE_ROWS[0]
    assert rows(1.0)[[0, -1]] == pytest.approx([0.25 * height, 0.75 * height], abs=2)
    assert len(rows(50.0)) == 0
    assert len(rows(None)) == 0


@given(st.floats(0.0, 1.0), st.sampled_from([DARK, LIGHT]))
@settings(max_examples=50)
def test_the_playhead_is_one_line_within_the_frame(fraction, theme) -> None:
    plain = np.zeros((SIZE_PX, SIZE_PX, 4), dtype=np.uint8)
    marked = draw_playhead(plain, fraction, theme)
    changed = np.flatnonzero((marked != plain).any(axis=(0, 2)))
    assert len(changed) == PLAYHEAD_PX
    assert FRAME_PX <= changed[0] <= find_column(fraction) <= changed[-1] < SIZE_PX - FRAME_PX
    assert draw_playhead(plain, None, theme) is plain


@pytest.mark.parametrize("theme", [DARK, LIGHT])
@pytest.mark.parametrize("peak", [0.1, 1.9, 2.0, 40.0])
def test_labels_hide_no_curve(monkeypatch, theme, peak) -> None:
    """Without its labels the picture is another in their rows alone, where nothing else is, and in the spectrogram."""
    style = ImageStyle(theme, 1.5, True, Ghost(tone(150.0, peak=3.0), hand(150)))
    labelled = draw_stroke_image(tone(200.0, peak=peak), hand(), style)[::-1]
    monkeypatch.setattr(stroke_image, "draw_text", lambda *_, **__: None)
    bare = draw_stroke_image(tone(200.0, peak=peak), hand(), style)[::-1]
    rows = np.zeros(SIZE_PX, dtype=bool)
    for first, _ in (WAVE_ROWS, ACTION_ROWS):
        rows[first - LABEL_ROWS : first] = True
    assert (bare[rows, FRAME_PX:-FRAME_PX, :3] == np.array(theme.back, np.float32)).all()
    rows[slice(*SPECTROGRAM_ROWS)] = True
    assert np.array_equal(labelled[~rows], bare[~rows])
    assert not np.array_equal(labelled[rows], bare[rows])


def test_a_ghost_shows_where_it_is_the_larger_one() -> None:
    """A of 4 m/s² behind B of 1 m/s²: one scale of 5 m/s², B in its own color, A beyond it; the action's force, too."""
    faint, strong = np.array(DARK.ghost, np.float32), np.array(DARK.wave, np.float32)

    def count(image, colour, columns=slice(SIZE_PX)):
        """Largest number of rows with the color in one of the columns."""
        track = image[::-1][slice(*WAVE_ROWS), columns, :3]
        return int((np.abs(track - colour).max(axis=-1) < 1e-6).sum(axis=0).max())

    alone = draw_stroke_image(tone(200.0, peak=1.0), hand(), ImageStyle(DARK))
    ghost = Ghost(tone(200.0, peak=4.0, seconds=0.5), hand(101))
    image = draw_stroke_image(tone(200.0, peak=1.0), hand(), ImageStyle(DARK, ghost=ghost))
    height = WAVE_ROWS[1] - WAVE_ROWS[0]
    assert count(alone, faint) == 0
    assert count(image, faint, slice(SIZE_PX // 2)) >= 0.5 * height
    assert count(image, faint, slice(SIZE_PX // 2 + 4, None)) == 0  # A is half as long.
    assert 0.1 * height < count(image, strong) < 0.3 * height < count(alone, strong)


@given(st.integers(90, 360), st.tuples(st.integers(0, 60), st.integers(0, 60)), st.integers(0, 2**31), st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_picture_is_found_on_a_screen(size, corner, seed, is_dark) -> None:
    """With noise around it; and it is not found from beside it."""
    (left, bottom), theme = corner, DARK if is_dark else LIGHT
    image = to_bytes(draw_stroke_image(tone(150.0), hand(), ImageStyle(theme, 1.0, True)))
    image = draw_playhead(image, 0.5, theme)
    nearest = ((np.arange(size) + 0.5) * SIZE_PX / size).astype(int)
    scaled = image[nearest][:, nearest]
    random = np.random.default_rng(seed)
    screen = random.integers(0, 256, (bottom + size + 20, left + size + 20, 4), dtype=np.uint8)
    screen[bottom : bottom + size, left : left + size] = scaled
    inside = size // 8 + int(random.integers(size - size // 4)), size // 8 + int(random.integers(size - size // 4))
    found = find_on_screen(screen, left + inside[0], bottom + inside[1], theme)
    assert found is not None
    edge = FRAME_PX * size / SIZE_PX + 2.0
    assert found[0] == pytest.approx(left, abs=edge)
    assert found[1] == pytest.approx(left + size - 1, abs=edge)
    assert find_on_screen(screen, left + size + 10, bottom + size // 2, theme) is None
    assert find_on_screen(screen, -1, 5, theme) is None


def test_both_themes_can_be_read() -> None:
    """Contrast of text with its ground by WCAG 2.1, at least 4.5 : 1."""

    def luminance(colour):
        linear = np.where(
            np.array(colour) <= 0.04045, np.array(colour) / 12.92, ((np.array(colour) + 0.055) / 1.055) ** 2.4
        )
        return float(linear @ [0.2126, 0.7152, 0.0722])

    for theme in (DARK, LIGHT):
        for colour in (theme.ink, theme.limit, theme.force, theme.speed, theme.wave):
            one, two = sorted((luminance(colour), luminance(theme.back)), reverse=True)
            assert (one + 0.05) / (two + 0.05) >= 4.5, (colour, theme.back)


def test_letters_have_their_shape() -> None:
    assert rasterise_text("1").shape == (7, 6)
    assert "".join("#" if ink else "." for ink in rasterise_text("l")[0]) == ".##..."
    assert len({rasterise_text(each).tobytes() for each in "0123456789"}) == 10


def test_a_signal_on_its_way_is_drawn_only_where_it_takes_long(monkeypatch) -> None:
    """What comes at once would be kept waiting by the drawing of its announcement."""
    from types import SimpleNamespace

    from hnf_blender import preview

    now = [10.0]
    monkeypatch.setattr(preview, "time", SimpleNamespace(monotonic=lambda: now[0]))
    ready, busy = preview.PreviewFacts("Along"), preview.PreviewFacts("Along", busy=True)
    looked = preview.SceneSnapshot()
    assert preview._delay_busy(None, looked) is None
    for _ in range(2):  # the second announcement waits as long as the first
        assert preview._delay_busy(busy, looked) == ready
        now[0] += preview.BUSY_DELAY_S
        assert preview._delay_busy(busy, looked) == busy
        assert preview._delay_busy(ready, looked) == ready
