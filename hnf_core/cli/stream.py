"""`hnf stream`: play a WAV on an actuator, or what a hand feels whose motion comes from another program.

With a level meter, and a warning if the limiter will change the signal of a WAV.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

import numpy as np

from ..actuators.hand_input import INPUT_FORMS, SLIDE_STEP_S, HandInput, parse_input, read_lines, receive_osc
from ..actuators.limits import Limits
from ..actuators.live_source import LiveSource
from ..actuators.measure.inverse_filter import make_compensation
from ..actuators.output_prediction import LimitingForecast, describe_peak_limit, predict_limiting
from ..actuators.profile import GENERIC, ActuatorProfile, load_profile
from ..actuators.signal_chain import Samples, SignalChain, Source
from ..actuators.sink import SinkFormat
from ..actuators.sources import Acceleration, BufferSource, TruncatedSource, db_to_gain, read_accelerations
from ..actuators.stream import Stream, StreamReport
from ..actuators.stream_targets import TARGET_FORMS, FileTarget, Target, make_sink, parse_target
from ..errors import DeviceError, UsageError, pluralize
from ..field.live.synthesis import create_live_synthesis
from ..material.hnf_file import HNF_SUFFIX
from ..material.probe import PROBE_NAMES
from ..material.ranking import find_material
from .commands import HELP, parse_seed

METER_MIN_DB = -60.0
PLAIN_LINE_INTERVAL_S = 5.0
METER_WIDTH = 12


class LevelMeter:
    """Level meter: one line that is redrawn on a terminal, else a plain line now and then.

    The bar's full length is an RMS level of `full_m_s2`. `duration_s` is the playing time, None if it plays until it is
    stopped.
    """

    def __init__(self, full_m_s2: float, duration_s: float | None, stream: TextIO | None = None) -> None:
        self._full, self._duration_s = full_m_s2, duration_s
        self._stream = stream or sys.stderr
        self._redraws = self._stream.isatty()
        self._next_s = time.monotonic() + PLAIN_LINE_INTERVAL_S

    def show(self, report: StreamReport) -> None:
        """Print the present state of a stream."""
        line = format_meter(report, self._full, self._duration_s)
        if self._redraws:
            columns = shutil.get_terminal_size().columns  # a wrapped line cannot be redrawn
            self._stream.write(f"\r\x1b[K{line[: columns - 1]}")
            self._stream.flush()
        elif time.monotonic() >= self._next_s:
            self._next_s += PLAIN_LINE_INTERVAL_S
            print(line, file=self._stream, flush=True)

    def close(self) -> None:
        """Erase the redrawn line."""
        if self._redraws:
            self._stream.write("\r\x1b[K")
            self._stream.flush()


def format_meter(report: StreamReport, full_m_s2: float, duration_s: float | None) -> str:
    """Format time, RMS level (a bar and dB re `full_m_s2`), underruns and limited samples."""
    total = f" of {duration_s:.1f}" if duration_s is not None else ""
    level_db = 20.0 * math.log10(report.level_m_s2 / full_m_s2) if report.level_m_s2 > 0.0 else -math.inf
    fraction = min(max(1.0 - level_db / METER_MIN_DB, 0.0), 1.0)
    filled = round(METER_WIDTH * fraction)
    level = f"{level_db:4.0f} dB" if level_db >= METER_MIN_DB else " silent"
    bar = f"{'█' * filled}{'·' * (METER_WIDTH - filled)}"
    counts = f"underruns {report.underruns}  limited {report.limited_samples}"
    return f"{report.played_s:6.1f}{total} s  {bar} {level} {report.level_m_s2:6.2f} m/s²  {counts}"


MAX_CHECKED_S = 120.0
"""Longest part [s] of a signal, around its peak, that is checked before playing, since the user waits meanwhile."""
WARM_TIME_CONSTANTS = 6.0
"""Time constants after which a coil has reached its final temperature."""


def compute_checked_duration(duration_s: float, seconds: float | None, *, loop: bool, thermal_s: float) -> float:
    """Return how many seconds of playing are simulated beforehand to predict the limiter.

    seconds: requested playing time, None for the whole signal. A loop is simulated until it has warmed the coil (time
    constant thermal_s).
    """
    plays_s = duration_s + WARM_TIME_CONSTANTS * thermal_s if loop else duration_s
    return min(plays_s if seconds is None else seconds if loop else min(seconds, duration_s), MAX_CHECKED_S)


def cut_strongest(found: Acceleration, seconds: float) -> Acceleration:
    """Return `seconds` of a signal around its largest sample, or all of it if it is no longer."""
    count = round(seconds * found.rate_hz)
    if count >= len(found.samples):
        return found
    peak_index = int(np.abs(found.samples).max(axis=1).argmax())
    start = min(max(peak_index - count // 2, 0), len(found.samples) - count)
    return replace(found, samples=found.samples[start : start + count])


def format_limit_warning(
    found: LimitingForecast, profile: ActuatorProfile, device: SinkFormat, largest_m_s2: float, *, partial: bool
) -> str:
    """Format a one-line warning that the limiter will change the signal.

    Parameters
    ----------
    found : LimitingForecast
        The predicted changes.
    profile : ActuatorProfile
        Profile (limits and response) of the actuator.
    device : SinkFormat
        Format and peak of the device.
    largest_m_s2 : float
        Peak of the signal with its gain [m/s²].
    partial : bool
        Whether only the part around the peak was checked.

    Returns
    -------
    str
        The warning.
    """
    limits = profile.limits.with_device_peak(device.peak)
    largest_allowed = limits.peak * limits.full_scale_m_s2
    reasons = []
    if found.peak and largest_m_s2 > largest_allowed:
        reasons.append(f"{largest_m_s2:.3g} m/s² is more than the {largest_allowed:.4g} m/s² of '{profile.title}'")
    elif found.peak and profile.response is not None:
        reasons.append(
            f"with the response of '{profile.title}' corrected, it is more than its {largest_allowed:.4g} m/s²"
        )
    elif found.peak:
        reasons.append(f"between its samples it is more than the {largest_allowed:.4g} m/s² of '{profile.title}'")
    if found.slew:
        reasons.append(f"it changes faster than '{profile.title}' may follow")
    if found.heat:
        reasons.append(f"it warms the coil of '{profile.title}' beyond what it carries for long")
    limited_share = f"{found.share:.2%}" if found.share >= 5e-5 else "less than 0.01%"
    advice = "No --gain makes it fit: check the file's unit."
    if found.max_gain_db is not None:
        advice = f"--gain {found.max_gain_db:.1f} fits."
    where = f" about its strongest place ({MAX_CHECKED_S:.0f} s)" if partial else ""
    return f"{', and '.join(reasons)}: {limited_share} of the samples{where} are limited. {advice}"


AHEAD_BLOCKS = 3
POLL_S = 0.05


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf stream`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "stream",
        help=HELP["stream"],
        description="Play WAVs on an actuator, each channel on one of its own, within its limits; or, with --input, "
        "what a hand feels whose motion comes from another program. Ctrl C stops softly.",
    )
    parser.add_argument(
        "wav", type=Path, nargs="*", metavar="FILE.wav", help="m/s² where it says so; several play beside each other"
    )
    parser.add_argument(
        "--input", metavar="osc:PORT|-",
        help="feel live what comes as OSC messages or as lines of standard input: x and y [m], force [N]",
    )  # fmt: skip
    parser.add_argument(
        "--material", action="append", default=[], metavar="NAME|FILE.hnf",
        help="what --input touches: of several, a message says which, from 0",
    )  # fmt: skip
    parser.add_argument("--probe", choices=PROBE_NAMES, help="what --input touches with (default pen)")
    parser.add_argument("--seed", type=parse_seed, metavar="N", help="seed of --input's noise (default 0)")
    parser.add_argument("--to", required=True, metavar="TARGET", help=TARGET_FORMS)
    parser.add_argument(
        "--profile", default=GENERIC.name, metavar="NAME|FILE.json",
        help=f"what the actuator can do, see `hnf actuators` (default {GENERIC.name})",
    )  # fmt: skip
    parser.add_argument("--loop", action="store_true", help="over and over, until Ctrl C or --seconds")
    parser.add_argument("--gain", type=float, default=0.0, metavar="DB", help="louder (+) or softer (−)")
    parser.add_argument(
        "--block", type=float, default=5.0, metavar="MS", help="make samples in blocks of it (default 5; 20 if busy)"
    )
    parser.add_argument(
        "--raw", action="store_true", help="leave out the inverse filter of a measured profile (hnf actuators measure)"
    )
    parser.add_argument(
        "--connect-timeout", type=float, metavar="S", help="how long to wait for a board to answer (default 10)"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after that long")
    parser.add_argument("--json", action="store_true", help="end with the report as one JSON object")
    return parser


def run(arguments: argparse.Namespace) -> int:
    """Run `hnf stream`; return the exit code. Raises HnfError."""
    _check_what_plays(arguments)
    if arguments.input is not None:
        return _run_live(arguments)
    target, gain = parse_target(arguments.to), db_to_gain(arguments.gain)
    _check_arguments(arguments, target)
    profile = load_profile(arguments.profile)
    limits = profile.limits
    recorded = read_accelerations(arguments.wav, limits)
    source, duration_s = _make_source(recorded, gain, arguments.loop, arguments.seconds)
    sink = make_sink(target, recorded.rate_hz, limits, source.channels, connect_s=arguments.connect_timeout)
    # A recording does not react to anybody, so the slower resampler with more delay is used.
    stages = () if arguments.raw else make_compensation(profile, recorded.rate_hz, source.channels)
    block_s = arguments.block / 1e3
    stream = Stream(
        source, sink, limits, block_s=block_s, ahead_blocks=AHEAD_BLOCKS, processors=stages, low_latency=False
    )

    def on_start(device: SinkFormat) -> None:
        if not arguments.json:
            print(_describe_playback(arguments, recorded, profile, device), flush=True)
        _print_warning(arguments, recorded, profile, device)

    with _sigterm_as_ctrl_c():
        try:
            device = stream.start(on_start)
            device_limits = limits.with_device_peak(device.peak)
            _show_levels(stream, LevelMeter(device_limits.peak * device_limits.full_scale_m_s2, duration_s))
        except KeyboardInterrupt:
            pass
        finally:
            stream.stop()
    return _report_result(arguments, profile, recorded, stream.report)


LIVE_BLOCK_S = 0.005
"""Block length of a live touch [s]."""


class Scaling:
    """Processor that makes a signal louder or softer by a factor."""

    def __init__(self, factor: float) -> None:
        self._factor = np.float32(factor)

    def process(self, block: Samples) -> Samples:
        """Scale a block of samples."""
        return np.asarray(self._factor * block, dtype=block.dtype)


RELEASE_S = 0.2
"""Duration of a live touch after the last line of its input, until a lift is silent and played [s]."""


def _check_what_plays(arguments: argparse.Namespace) -> None:
    """Raise UsageError unless either WAVs are given, or an input with a material."""
    if arguments.input is None:
        of_input = [name for name in ("material", "probe", "seed") if getattr(arguments, name) not in (None, [])]
        if of_input:
            raise UsageError(
                f"--{of_input[0]} goes with --input.", remedy=f"Leave it out, or give --input {INPUT_FORMS}."
            )
        if not arguments.wav:
            raise UsageError("there is nothing to play.", remedy="Give a WAV, or --input and --material.")
        return
    if arguments.wav or arguments.loop:
        raise UsageError("--input plays no WAV.", remedy="Leave out the WAVs and --loop, or --input.")
    if not arguments.material:
        raise UsageError(
            "--input needs something to touch.", remedy="Give --material NAME; `hnf materials` lists them."
        )


def _run_live(arguments: argparse.Namespace) -> int:
    """Play what a hand feels whose motion comes from outside; return the exit code. Raises HnfError."""
    received, target, gain = parse_input(arguments.input), parse_target(arguments.to), db_to_gain(arguments.gain)
    if isinstance(target, FileTarget):
        raise UsageError(
            "a live touch is played on a device.", remedy="Give --to audio, serial:PORT, osc:… or virtual."
        )
    _check_arguments(arguments, target)
    profile, materials = load_profile(arguments.profile), [_choose_material(name) for name in arguments.material]
    source = LiveSource(create_live_synthesis(*materials, seed=arguments.seed or 0, probe=arguments.probe or "pen"))
    hand = HandInput(source, lambda problem: print(f"hnf: {problem}", file=sys.stderr, flush=True))
    sink = make_sink(target, source.rate_hz, profile.limits, source.channels, connect_s=arguments.connect_timeout)
    stages = () if arguments.raw else make_compensation(profile, source.rate_hz, source.channels)
    block_s = min(arguments.block / 1e3, LIVE_BLOCK_S)
    stream = Stream(source, sink, profile.limits, block_s=block_s, ahead_blocks=1, processors=(Scaling(gain), *stages))
    ended = threading.Event()
    with _sigterm_as_ctrl_c():
        try:
            device = stream.start()
            if not arguments.json:
                print(
                    f"{', '.join(arguments.material)} under {_describe_input(received)}\nto {device.device}: "
                    f"{device.rate_hz:g} Hz; gain {arguments.gain:g} dB; {describe_peak_limit(profile, device)}",
                    flush=True,
                )
            with _feed(hand, received, ended):
                _follow_hand(stream, hand, ended, arguments.seconds, device, profile.limits)
        except KeyboardInterrupt:
            pass
        finally:
            stream.stop()
    return _report_live(arguments, stream.report, source, hand)


def _feed(
    hand: HandInput, received: tuple[str, int] | None, ended: threading.Event
) -> AbstractContextManager[int | None]:
    """Feed a hand from OSC or from standard input, of which bytes that are no text only spoil their line."""
    if received is not None:
        return receive_osc(hand, *received)
    return read_lines(hand, _iterate_input(), ended.set)


def _iterate_input() -> Iterator[str]:
    """Yield the lines of standard input as they come.

    They are read past `sys.stdin`, whose lock a thread that still waits would hold when Python ends, which aborts it.
    """
    rest = b""
    while chunk := os.read(sys.stdin.fileno(), 65536):
        *lines, rest = (rest + chunk).split(b"\n")
        yield from (line.decode("utf-8", "replace") for line in lines)
    yield rest.decode("utf-8", "replace")


def _choose_material(name: str) -> str:
    """Return a file's name or that of the library material that words name; print what is taken for words."""
    if name.lower().endswith(HNF_SUFFIX):
        return name
    found, suggestion = find_material(name)
    if suggestion is not None:
        print(f"hnf: no library material is called {name!r}: {found.name} is taken.", file=sys.stderr)
    return found.name


def _describe_input(received: tuple[str, int] | None) -> str:
    return "standard input" if received is None else f"OSC at {received[0]}:{received[1]}"


def _follow_hand(
    stream: Stream, hand: HandInput, ended: threading.Event, seconds: float | None, device: SinkFormat, limits: Limits
) -> None:
    """Continue slides and show the level until the input or the time ends, or the stream fails."""
    allowed = limits.with_device_peak(device.peak)
    meter = LevelMeter(allowed.peak * allowed.full_scale_m_s2, seconds)
    stop_s, shown_s = math.inf if seconds is None else time.monotonic() + seconds, 0.0
    try:
        while not stream.wait(SLIDE_STEP_S) and (now_s := time.monotonic()) < stop_s:
            hand.advance()
            if ended.is_set():
                stop_s = min(stop_s, now_s + RELEASE_S)
                ended.clear()
            if now_s - shown_s >= POLL_S:
                shown_s = now_s
                meter.show(stream.report)
    finally:
        meter.close()


def _report_live(arguments: argparse.Namespace, report: StreamReport, source: LiveSource, hand: HandInput) -> int:
    if arguments.json:
        facts = {"input": arguments.input, "materials": arguments.material, "target": arguments.to}
        counts = {"messages": hand.messages, "refused": hand.refused, "latency_p99_ms": source.latency_p99_ms}
        print(json.dumps(facts | counts | report.to_json(), indent=1))
    else:
        print(
            f"{report.played_s:.2f} s played: {pluralize(hand.messages, 'message')}, {hand.refused} refused; 99 % of "
            f"them computed within {source.latency_p99_ms:.1f} ms, {pluralize(report.underruns, 'underrun')}; peak "
            f"{report.peak:.0%} of full scale, {pluralize(report.limited_samples, 'sample')} limited"
        )
    if report.problem:
        raise DeviceError(report.problem)
    return 0


def _check_arguments(arguments: argparse.Namespace, target: Target) -> None:
    if arguments.seconds is not None and not 0.0 < arguments.seconds < 1e7:
        raise UsageError(f"--seconds {arguments.seconds:g} is no time to play.", remedy="Give more than 0.")
    if not isinstance(target, FileTarget):
        return
    if target.path.exists() and any(wav.exists() and target.path.samefile(wav) for wav in arguments.wav):
        raise UsageError(f"--to {arguments.to} is the file that is read.", remedy="Give another name.")
    if arguments.loop and arguments.seconds is None:
        raise UsageError("--loop into a file never ends.", remedy="Say how long: --seconds 10.")


def _make_source(found: Acceleration, gain: float, loop: bool, seconds: float | None) -> tuple[Source, float | None]:
    """Return the source of samples to play, and its playing time [s], None if it plays without end."""
    source, duration_s = BufferSource(found.samples * np.float32(gain), found.rate_hz, loop=loop), found.duration_s
    if seconds is None:
        return source, None if loop else duration_s
    return TruncatedSource(source, round(seconds * found.rate_hz)), seconds if loop else min(seconds, duration_s)


def _describe_playback(
    arguments: argparse.Namespace, found: Acceleration, profile: ActuatorProfile, device: SinkFormat
) -> str:
    delay_ms = 1e3 * device.queue_frames / device.rate_hz
    delay = "" if isinstance(parse_target(arguments.to), FileTarget) else f", delay at most {delay_ms:.0f} ms"
    compensation = ", with its response corrected" if profile.response is not None and not arguments.raw else ""
    channels = f" on {found.samples.shape[1]} channels" if found.samples.shape[1] > 1 else ""
    return (
        f"{_join_names(arguments)}: {found.duration_s:.2f} s at {found.rate_hz:g} Hz{channels}, {found.unit}, "
        f"largest {found.peak_m_s2:.3g} m/s²\n"
        f"to {device.device}: {device.rate_hz:g} Hz{delay}; gain {arguments.gain:g} dB; "
        f"{describe_peak_limit(profile, device)}{compensation}"
    )


def _join_names(arguments: argparse.Namespace) -> str:
    return ", ".join(map(str, arguments.wav))


def _print_warning(
    arguments: argparse.Namespace, found: Acceleration, profile: ActuatorProfile, device: SinkFormat
) -> None:
    """Print a warning before playing if the limiter is predicted to change the signal."""
    limits, loop = profile.limits, arguments.loop
    plays_s = found.duration_s if arguments.seconds is None or loop else min(arguments.seconds, found.duration_s)
    played = replace(found, samples=found.samples[: max(round(plays_s * found.rate_hz), 1)])
    checked = cut_strongest(played, MAX_CHECKED_S)
    seconds = compute_checked_duration(checked.duration_s, arguments.seconds, loop=loop, thermal_s=limits.thermal_s)

    def make_chain(limits: Limits, gain_db: float) -> SignalChain:
        source, _ = _make_source(checked, db_to_gain(gain_db), loop, seconds)
        stages = () if arguments.raw else make_compensation(profile, found.rate_hz, source.channels)
        return SignalChain(source, device, limits, stages, low_latency=False)

    largest_allowed = limits.with_device_peak(device.peak).peak * limits.full_scale_m_s2
    guess_db = 20.0 * math.log10(largest_allowed / checked.peak_m_s2) if checked.peak_m_s2 > 0.0 else 0.0
    forecast = predict_limiting(make_chain, limits, arguments.gain, guess_db)
    if forecast is not None:
        largest, partial = checked.peak_m_s2 * db_to_gain(arguments.gain), checked is not played
        print(f"hnf: {format_limit_warning(forecast, profile, device, largest, partial=partial)}", file=sys.stderr)


def _show_levels(stream: Stream, meter: LevelMeter) -> None:
    try:
        while not stream.wait(POLL_S):
            meter.show(stream.report)
    finally:
        meter.close()


def _report_result(
    arguments: argparse.Namespace, profile: ActuatorProfile, found: Acceleration, report: StreamReport
) -> int:
    if arguments.json:
        inputs = {"wav": _join_names(arguments), "unit": found.unit, "target": arguments.to, "profile": profile.name}
        scale = {"full_scale_m_s2": profile.limits.full_scale_m_s2, "full_scale_assumed": profile.assumes_full_scale}
        print(json.dumps(inputs | scale | report.to_json(), indent=1))
    else:
        print(
            f"{report.played_s:.2f} s played: {pluralize(report.blocks, 'block')}, 99 % of them computed within "
            f"{report.compute_p99_ms:.2f} ms, {pluralize(report.underruns, 'underrun')}; peak {report.peak:.0%} of "
            f"full "
            f"scale, {pluralize(report.limited_samples, 'sample')} limited"
        )
    if report.device_limited_samples:
        print(
            f"hnf: the device itself cut {pluralize(report.device_limited_samples, 'sample')} short. "
            "Play softer, or correct the peak in its firmware.",
            file=sys.stderr,
        )
    if report.problem:
        raise DeviceError(report.problem)
    return 0


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    """Handle SIGTERM as Ctrl C within this context, so that it stops the signal as softly."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handler = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
