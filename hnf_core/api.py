"""Functions and classes of `import hnf_core as hnf`: from material and hand action to a signal, a file or an actuator.

Every function takes lists, numpy arrays and plain path strings, and raises an `HnfError` with a remedy for a wrong
shape, unit or rate. Packages that a call does not need are not imported: torch only by `train`, bpy only by `touch`.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .action.action import Action as GridAction
from .action.action import action_from_table, check_plausibility, read_action_table
from .action.parse_stroke import parse_stroke as parse_stroke
from .action.primitives import Primitive
from .errors import FileError, HnfError, UsageError, check_seed
from .field.field import Field
from .field.stroke import Synthesis
from .material.contact_model import Mechanics
from .material.probe import get_probe
from .signal import Signal, check_rate, to_signal, to_vector

if TYPE_CHECKING:
    from .actuators.stream import StreamReport
    from .actuators.stream_targets import Device
    from .export.convert import ExportResult

PathText = str | PathLike[str]

DEFAULT_RATE_HZ = 10_000.0
"""Sample rate of the model, and default sample rate of a signal [Hz]."""
MIN_TRAINING_S = 1.0
"""Shortest recording that a field can be trained on [s]."""


@dataclass(frozen=True)
class Material:
    """A material that can be touched.

    Attributes
    ----------
    name : str
        Its name in the library, or in the file it was read from.
    token : ndarray of float32, shape (D,)
        Feature vector of its micro-geometry, made by the encoder E (`material.token` has the layout).
    mechanics : Mechanics
        Stiffness [N/m], damping ratio and friction; unknown values are None.
    field : Field or None
        A field (synthesis network) trained for this material alone; None means the shared one.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.material("oak-wood").name
    'oak-wood'
    """

    name: str
    token: NDArray[np.float32]
    mechanics: Mechanics
    field: Field | None = None


@dataclass(frozen=True)
class Action:
    """Motion and force of the hand, u(t) = [direction, speed, normal force], on any rising time grid.

    Values that seem to have another unit, or contradict each other, are taken as they are and warned of (UserWarning).

    Parameters
    ----------
    time_s : array_like, shape (n,)
        Times, rising [s].
    direction_rad : array_like, shape (n,), or float
        Direction of motion in the surface's tangent frame [rad]; a number stands for all times.
    speed_m_s : array_like, shape (n,), or float
        Speed along the path, not negative [m/s].
    force_n : array_like, shape (n,), or float
        Normal force, not negative; 0 is no contact [N].
    probe : str
        The contacting tip: ``"pen"``, ``"finger"``, or the name or file of another one.
    position_m : array_like, shape (n,), optional
        Signed position along the path [m], for a hand that goes back on it; by default the integral of speed.

    Raises
    ------
    StrokeError
        For columns of different lengths, times that do not rise, values that are not finite, negative speed or force.
    UsageError
        For values that are no numbers, or a probe that is not known.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> action = hnf.Action([0.0, 1.0], 0.0, [0.05, 0.1], 1.0)
    >>> action.duration_s
    1.0
    """

    time_s: ArrayLike
    direction_rad: ArrayLike
    speed_m_s: ArrayLike
    force_n: ArrayLike
    probe: str = "pen"
    position_m: ArrayLike | None = None

    def __post_init__(self) -> None:
        get_probe(self.probe)
        time = to_vector(self.time_s, "time_s")
        object.__setattr__(self, "time_s", time)
        for name in ("direction_rad", "speed_m_s", "force_n"):
            values = getattr(self, name)
            is_number = np.ndim(values) == 0
            column = np.full(len(time), to_vector([values], name)[0]) if is_number else to_vector(values, name)
            object.__setattr__(self, name, column)
        if self.position_m is not None:
            object.__setattr__(self, "position_m", to_vector(self.position_m, "position_m"))
        self.to_grid()  # raises StrokeError for values that make no action
        time, direction, speed = (np.asarray(each) for each in (self.time_s, self.direction_rad, self.speed_m_s))
        position = None if self.position_m is None else np.asarray(self.position_m)
        for message in check_plausibility(time, direction, speed, position):
            warnings.warn(message, stacklevel=3)  # of the caller, behind __init__

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last [s]."""
        time = np.asarray(self.time_s)
        return float(time[-1] - time[0])

    def to_grid(self) -> GridAction:
        """Return the action resampled to the even grid of 200 Hz on which the synthesis network is evaluated."""
        columns = (
            np.asarray(column, dtype=np.float64)
            for column in (self.time_s, self.direction_rad, self.speed_m_s, self.force_n)
        )
        position = None if self.position_m is None else np.asarray(self.position_m, dtype=np.float64)
        return action_from_table(*columns, position=position, probe=self.probe)


@dataclass(frozen=True)
class Recording:
    """A recorded stroke: the acceleration, and the action of the hand meanwhile.

    Parameters
    ----------
    acceleration : array_like, shape (n,) or (n, 3)
        Acceleration [m/s²]. Its mean, such as gravity, is taken out, and three axes are fused into one by DFT321.
    rate_hz : float
        Sample rate of the acceleration [Hz].
    action : Action
        The action, as long as the acceleration.
    material : str
        Name of the recorded material.

    Raises
    ------
    UsageError
        For another shape, or samples that are not finite.
    FileError
        If acceleration and action are not equally long.

    Examples
    --------
    >>> import numpy as np
    >>> import hnf_core as hnf
    >>> action = hnf.Action([0.0, 2.0], 0.0, 0.1, 1.0)
    >>> hnf.Recording(np.zeros(20_000), rate_hz=10_000, action=action).duration_s
    2.0
    """

    acceleration: ArrayLike
    rate_hz: float
    action: Action
    material: str = "recorded"

    def __post_init__(self) -> None:
        from .signal import dft321

        try:
            samples = np.asarray(self.acceleration, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise UsageError(f"the acceleration is not made of numbers ({error}).") from error
        if not (samples.ndim == 1 or (samples.ndim == 2 and samples.shape[1] == 3)) or not len(samples):
            raise UsageError(
                f"an acceleration of shape {samples.shape} is neither (n,) nor (n, 3).",
                remedy="Give one axis, or three as columns.",
            )
        if not np.isfinite(samples).all():
            raise UsageError("the acceleration holds values that are not finite.", remedy="Cut the recording there.")
        check_rate(self.rate_hz)
        vibration = samples - samples.mean(axis=0)
        object.__setattr__(self, "acceleration", dft321(vibration) if samples.ndim == 2 else vibration)
        self._to_dataset_recording()  # raises FileError for samples and an action of different lengths

    @property
    def duration_s(self) -> float:
        """Duration of the samples [s]."""
        return len(np.asarray(self.acceleration)) / self.rate_hz

    def _to_dataset_recording(self) -> Any:
        from .datasets.recording import Recording as DatasetRecording

        return DatasetRecording(
            self.action.to_grid(),
            np.asarray(self.acceleration, dtype=np.float64),
            self.rate_hz,
            self.material,
            "a recording",
        )


def list_materials() -> tuple[str, ...]:
    """Return the names of the library's materials.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> "cork" in hnf.list_materials()
    True
    """
    from .material.library import load_library

    return tuple(entry.name for entry in load_library())


def material(name: str) -> Material:
    """Return a material of the library by its name.

    Parameters
    ----------
    name : str
        As `list_materials` gives it; case, blanks and underscores do not count.

    Returns
    -------
    Material

    Raises
    ------
    MaterialError
        For an unknown name; the message lists close ones.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.material("Oak wood").token.dtype
    dtype('float32')
    """
    return _get_library_material(name)


def load_material(path: PathText) -> Material:
    """Read a material from a file.

    Parameters
    ----------
    path : str or path
        A ``.hnf`` file, or the ``.safetensors`` weights of a field trained for one material.

    Returns
    -------
    Material

    Raises
    ------
    FileError, WeightsError
        If the file is missing, damaged or holds no material.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.load_material("mine.hnf")  # doctest: +SKIP
    """
    from .field.weights import load_field, read_trained_material, resolve_material_field
    from .material.hnf_file import HNF_SUFFIX, read_hnf

    file = Path(fspath(path))
    if file.suffix.lower() != HNF_SUFFIX:
        field = load_field(file)
        entry = read_trained_material(field, str(file))
    else:
        field, entry = resolve_material_field(read_hnf(file), str(file))
    return Material(entry.name, entry.token, entry.mechanics, field)


def read_action(path: PathText, probe: str = "pen") -> Action:
    """Read an action from a CSV table with the columns time_s, direction_rad, speed_m_s and force_n.

    Parameters
    ----------
    path : str or path
        The table; any order of columns, any rising time grid, whose rows are kept. A column position_m is read too.
    probe : str
        The contacting tip: ``"pen"``, ``"finger"``, or the name or file of another one.

    Returns
    -------
    Action

    Raises
    ------
    FileError
        If it cannot be read or is no such table.
    StrokeError
        If its values make no action.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.read_action("stroke.csv")  # doctest: +SKIP
    """
    source, messages = Path(fspath(path)), list[str]()
    table = read_action_table(source, messages.append)
    columns = table.time, table.direction, table.speed, table.force
    action_from_table(*columns, position=table.position, probe=probe, where=str(source), lines=table.lines)
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        action = Action(*columns, probe, table.position)
    for message in (*messages, *(f"{source.name}: {doubt.message}" for doubt in doubts)):
        warnings.warn(message, stacklevel=2)
    return action


def synthesise(
    material: Material | Field | str,
    action: Action | Primitive | str,
    *,
    seed: int = 0,
    probe: str | None = None,
    rate_hz: float = DEFAULT_RATE_HZ,
) -> Synthesis:
    """Synthesise the acceleration of a stroke on a material.

    Parameters
    ----------
    material : Material, Field or str
        The material, a field (synthesis network) that `train` returned, or a name in the library.
    action : Action, Primitive or str
        The action, a stroke from `parse_stroke`, or its words.
    seed : int
        Seed of the noise carriers that the network modulates and of the path that a stroke in words takes: the same
        seed gives the same samples.
    probe : str, optional
        The contacting tip; by default that of the action, which is the pen for a primitive.
    rate_hz : float
        Sample rate of the signal [Hz].

    Returns
    -------
    Synthesis
        ``signal`` (acceleration in m/s²), ``confidence`` (0 to 1) and ``warnings``.

    Raises
    ------
    MaterialError, StrokeError, UsageError
        For a material, stroke, probe or rate that cannot be used.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> touch = hnf.synthesise("oak-wood", "rub-slow", seed=1)
    >>> touch.signal.sample_rate, touch.signal.samples.ndim
    (10000.0, 1)
    """
    from .field.stroke import uniform_stroke
    from .field.synthesis import synthesise as synthesise_stroke
    from .field.weights import load_field, read_trained_material

    if isinstance(material, str):
        material = _get_library_material(material)
    if isinstance(material, Field):
        trained = read_trained_material(material, "the field")
        material = Material(trained.name, trained.token, trained.mechanics, material)
    if not isinstance(material, Material):
        raise UsageError(f"{type(material).__name__} is no material.", remedy="Give hnf.material(NAME) or a field.")
    check_seed(seed)
    grid, stroke_name = _to_grid(action, seed)
    if probe is not None:
        get_probe(probe)
        grid = replace(grid, probe=probe)
    check_rate(rate_hz)
    stroke = uniform_stroke(grid, material.token, material.mechanics)
    field = load_field() if material.field is None else material.field
    result = synthesise_stroke(field, stroke, seed=seed, sample_rate=float(rate_hz))
    provenance = {**result.signal.provenance, "stroke": stroke_name, "material": material.name}
    return replace(result, signal=replace(result.signal, provenance=provenance))


def write_wav(path: PathText, signal: Signal | ArrayLike, rate_hz: float | None = None) -> None:
    """Write a signal as a float32 WAV in m/s², atomically.

    Parameters
    ----------
    path : str or path
        The file to write.
    signal : Signal or array_like, shape (n,)
        The signal; an array is acceleration in m/s² and needs `rate_hz`.
    rate_hz : float, optional
        Sample rate of an array [Hz].

    Raises
    ------
    FileError
        For samples that are not finite, a rate that is no whole number of Hz, or a full disk.
    UsageError
        For an array without a rate.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> touch = hnf.synthesise("cork", "left-right-soft")
    >>> hnf.write_wav("cork.wav", touch.signal)
    """
    from .export.wav import write_wav as write

    write(Path(fspath(path)), to_signal(signal, rate_hz))


def read_signal(path: PathText, full_scale: float | None = None) -> Signal:
    """Read a signal in m/s² from a WAV or from any format that `export` writes.

    Parameters
    ----------
    path : str or path
        The file; its suffix decides the format.
    full_scale : float, optional
        Acceleration of a sample of 1.0 in a file that does not state it [m/s²].

    Returns
    -------
    Signal

    Raises
    ------
    FileError
        If the file is missing, damaged or states no unit.
    UsageError
        For a suffix that is not known.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.write_wav("tone.wav", [0.0, 1.0, 0.0, -1.0], rate_hz=1000)
    >>> len(hnf.read_signal("tone.wav").samples)
    4
    """
    from .export.convert import import_signal
    from .export.options import ImportOptions

    return import_signal(Path(fspath(path)), ImportOptions(full_scale_m_s2=full_scale))


def export(
    path: PathText,
    signal: Signal | ArrayLike,
    *,
    rate_hz: float | None = None,
    format: str | None = None,
    full_scale: float | None = None,
) -> ExportResult:
    """Write a signal in the format of another program, and measure what the format loses.

    Parameters
    ----------
    path : str or path
        The file to write.
    signal : Signal or array_like, shape (n,)
        The signal; an array is acceleration in m/s² and needs `rate_hz`.
    rate_hz : float, optional
        Sample rate of an array [Hz].
    format : str, optional
        A format's name, as ``hnf export --help`` lists them; by default the one of the suffix.
    full_scale : float, optional
        Acceleration of the largest value of the format [m/s²].

    Returns
    -------
    ExportResult
        ``loss`` (measured on the file, read again) and ``dropped`` (the parts of the signal that the format cannot
        store).

    Raises
    ------
    FileError, UsageError
        If the format cannot hold the signal, or the file cannot be written.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> touch = hnf.synthesise("cork", "left-right-soft")
    >>> hnf.export("cork.haptic", touch.signal, full_scale=20.0).form.word
    'haptic'
    """
    from .export.convert import export_signal
    from .export.formats import format_of, format_of_file
    from .export.options import DEFAULT_FULL_SCALE_M_S2, ExportOptions

    file = Path(fspath(path))
    form = format_of_file(file, is_written=True) if format is None else format_of(format)
    options = ExportOptions(
        DEFAULT_FULL_SCALE_M_S2 if full_scale is None else full_scale,
        full_scale_assumed=form.scaled and full_scale is None,
    )
    return export_signal(to_signal(signal, rate_hz), form, file, options)


def train(recordings: Recording | Iterable[Recording], *, seed: int = 0, epochs: int | None = None) -> Field:
    """Train a field, the network that synthesises acceleration, on recordings of one material.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Strokes over one material, 10 s or more in all for a usable field.
    seed : int
        Seed of initial weights and noise.
    epochs : int, optional
        Maximum number of epochs; by default that of ``hnf train field``.

    Returns
    -------
    Field
        For `synthesise` and `save_field`.

    Raises
    ------
    HnfError
        If torch is missing (``pip install`` the extra ``train``).
    UsageError
        For no recordings, or recordings that are too short.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> field = hnf.train(recordings, seed=0)  # doctest: +SKIP
    """
    strokes = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    if not all(isinstance(recording, Recording) for recording in strokes):
        raise UsageError("training needs recordings.", remedy="Give hnf.Recording(…), or a list of them.")
    if not strokes or sum(recording.duration_s for recording in strokes) < MIN_TRAINING_S:
        raise UsageError(f"less than {MIN_TRAINING_S:g} s of recordings.", remedy="Give more, or longer ones.")
    if len({recording.material for recording in strokes}) > 1:
        raise UsageError("the recordings are of several materials.", remedy="Train one field for each.")
    try:
        from .training.from_recordings import TrainingOverrides, train_from_recordings
    except ImportError as error:
        raise HnfError(f"training needs torch ({error}).", remedy="Install it: pip install torch scipy.") from error
    prepared = [recording._to_dataset_recording() for recording in strokes]
    trained, _ = train_from_recordings(prepared, "own", "", seed, TrainingOverrides(epochs=epochs), compare=True)
    return trained.field


def load_field(path: PathText | None = None) -> Field:
    """Read a field (synthesis network) from its weights; without a path, the shared field that the package ships.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.load_field().config.states
    5
    """
    from .field.weights import load_field as load

    return load(None if path is None else Path(fspath(path)))


def save_field(path: PathText, field: Field) -> None:
    """Write the weights of a field (synthesis network) as safetensors, atomically.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> hnf.save_field("shared.safetensors", hnf.load_field())
    """
    from .field.weights import save_field as save

    save(Path(fspath(path)), field)


def list_devices() -> tuple[Device, ...]:
    """Return the serial ports and sound outputs that `open_stream` can play on.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> isinstance(hnf.list_devices(), tuple)
    True
    """
    from .actuators.stream_targets import list_devices as list_found

    return list_found().all


class OutputStream:
    """An actuator opened by `open_stream`, on which signals are played."""

    def __init__(self, target: str, profile: str, gain_db: float) -> None:
        from .actuators.profile import load_profile
        from .actuators.sources import db_to_gain
        from .actuators.stream_targets import parse_target

        self._target, self._profile, self._gain = parse_target(target), load_profile(profile), db_to_gain(gain_db)
        self.report: StreamReport | None = None

    def play(self, signal: Signal | ArrayLike, rate_hz: float | None = None) -> StreamReport:
        """Play a signal to its end, within the limits of the actuator's profile.

        Parameters
        ----------
        signal : Signal or array_like, shape (n,)
            The signal; an array is acceleration in m/s² and needs `rate_hz`.
        rate_hz : float, optional
            Sample rate of an array [Hz].

        Returns
        -------
        StreamReport
            Counts of samples played, of limited samples and of underruns, with peak and time played.

        Raises
        ------
        DeviceError
            If the device is missing, busy or gone.
        """
        from .actuators.measure.inverse_filter import make_compensation
        from .actuators.sources import BufferSource
        from .actuators.stream import Stream
        from .actuators.stream_targets import make_sink

        played = to_signal(signal, rate_hz)
        limits = self._profile.limits
        source = BufferSource(played.samples[:, None] * np.float32(self._gain), played.sample_rate)
        sink = make_sink(self._target, played.sample_rate, limits, source.channels)
        processors = make_compensation(self._profile, played.sample_rate, source.channels)
        stream = Stream(source, sink, limits, processors=processors, low_latency=False)
        try:
            stream.start()
            stream.wait()
        finally:
            stream.stop()
            self.report = stream.report
        return self.report

    def __enter__(self) -> OutputStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


def open_stream(target: str = "virtual", *, profile: str = "generic-voice-coil", gain_db: float = 0.0) -> OutputStream:
    """Open an actuator to play signals on.

    Parameters
    ----------
    target : str
        ``"virtual"``, ``"audio[:DEVICE]"``, ``"serial:PORT[@BAUD]"``, ``"osc:HOST:PORT"`` or ``"file:PATH"``.
    profile : str
        Name or JSON file of the actuator's profile, as ``hnf actuators`` lists them.
    gain_db : float
        Gain applied to every signal [dB].

    Returns
    -------
    OutputStream
        A context manager with a method ``play(signal)``.

    Raises
    ------
    UsageError
        For a target or profile that is not known.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> touch = hnf.synthesise("cork", "left-right-soft")
    >>> with hnf.open_stream("file:played.wav") as out:
    ...     report = out.play(touch.signal)
    >>> report.underruns
    0
    """
    return OutputStream(target, profile, gain_db)


def touch(
    scene: PathText,
    out: PathText,
    *,
    strokes: Sequence[tuple[str, str]] = (),
    materials: Mapping[str, str] | None = None,
    metres_per_unit: float | None = None,
    seed: int | None = None,
) -> dict[str, Any]:
    """Synthesise every stroke of a Blender scene to WAV files, plots and a report; needs bpy.

    Parameters
    ----------
    scene : str or path
        A scene that Blender opens or imports.
    out : str or path
        Folder of the results.
    strokes : sequence of (words, object)
        Strokes to add to those drawn in the scene: words as for `parse_stroke`, and an object or ``"OBJECT:SLOT"``.
    materials : mapping, optional
        Library materials to use, by ``"OBJECT[:SLOT]"``.
    metres_per_unit : float, optional
        Length of one scene unit [m]; by default the scene's own.
    seed : int, optional
        Seed of all strokes; by default each stroke's own.

    Returns
    -------
    dict
        The report, as in ``report.json``; ``failed`` names strokes that could not be touched.

    Raises
    ------
    HnfError
        If bpy is missing, or the scene cannot be touched at all.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> report = hnf.touch("scene.blend", out="result")  # doctest: +SKIP
    """
    from importlib import import_module

    arguments = ["touch", fspath(scene), "--out", fspath(out)]
    for text, target in strokes:
        arguments += ["--stroke", text, "--on", target]
    for target, name in (materials or {}).items():
        arguments += ["--material", f"{target}={name}"]
    if metres_per_unit is not None:
        arguments += ["--scale", f"{metres_per_unit:.9g}"]
    if seed is not None:
        arguments += ["--seed", str(seed)]
    # This package may not import the add-on, which depends on it: the command is looked up by name, as by a shell.
    program = import_module("hnf_blender" + ".cli")
    report = Path(fspath(out)) / "report.json"
    before = report.stat().st_ino if report.is_file() else None  # A file that is written atomically is another one.
    is_whole = program.main(arguments) == 0
    if not is_whole and (not report.is_file() or report.stat().st_ino == before):
        raise HnfError("the scene could not be touched; the lines above say why.", where=fspath(scene))
    try:
        content: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"the report cannot be read ({error}).", where=str(report)) from error
    has_lost = any(stroke.get("off_surface", 0.0) > 0.0 for stroke in content.get("strokes", ()))
    if not is_whole and not (content.get("failed") or has_lost):  # What it tells is not all that was to be done.
        raise HnfError("the scene was not touched to the end; the lines above say why.", where=fspath(scene))
    return content


def _get_library_material(name: str) -> Material:
    if not isinstance(name, str):
        raise UsageError(f"{type(name).__name__} is no name of a material.", remedy="See hnf.list_materials().")
    from .material.library import get_material

    entry = get_material(name)
    return Material(entry.name, entry.token, entry.mechanics)


def _to_grid(action: Action | Primitive | str, seed: int) -> tuple[GridAction, str]:
    from .action.primitive_path import make_primitive_action

    if isinstance(action, Action):
        return action.to_grid(), "action"
    if isinstance(action, str):
        action = parse_stroke(action)
    if not isinstance(action, Primitive):
        raise UsageError(f"{type(action).__name__} is no action.", remedy="Give hnf.Action(…) or hnf.parse_stroke(…).")
    return make_primitive_action(action, seed=seed), action.name
