"""Options that several commands share, or that form a group of their own.

The field names are the names of the options and the docstrings below them are their help texts.
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, Token

from probedesign.cli.console import print_note, show_progress
from probedesign.core.errors import InputError
from probedesign.core.files import EXPORTS, chosen_exports, file_in

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.estimation.model import ProbeModel, Tolerances
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.sources.source import Source
    from probedesign.mapping.known_object import KnownObject, ObjectPose
    from probedesign.mapping.shapes import TouchSet
    from probedesign.optimization.objective import Task


def design_file(given: Path) -> Path:
    """Return the design file of an argument: the file, the one file of a folder, or NAME of designs/NAME.toml."""
    if given.is_file():
        return given
    named = _in_project(Path("designs", f"{given}.toml"), given)
    if not given.is_dir():
        return named
    if named.is_file() and not any(given.glob("*.toml")):
        return named  # the folder is that of its exports
    return file_in(given, "*.toml", "design")


def frozen_probe(given: Path) -> Path:
    """Return the frozen probe of an argument: the file, its folder, or NAME of exports/NAME.

    Of a folder with a frozen probe and its calibration the calibration counts if it is of the same geometry and newer.
    """
    deployed, calibrations = _frozen_probes(given)
    if not calibrations:
        return deployed
    try:
        same = len({json.loads(file.read_bytes())["fingerprint"] for file in (deployed, *calibrations)}) == 1
    except (OSError, ValueError, TypeError, KeyError):
        same = False
    if same and calibrations[0].stat().st_mtime >= deployed.stat().st_mtime:
        print_note(f"{calibrations[0]}: the calibration of {deployed.name}")
        return calibrations[0]
    print_note(f"{deployed}: {calibrations[0].name} is older or of another geometry; calibrate again")
    return deployed


def uncalibrated_probe(given: Path) -> Path:
    """Return the frozen probe of an argument as `frozen_probe`, without its calibration."""
    return _frozen_probes(given)[0]


def check_names(names: Sequence[str]) -> None:
    """Raise InputError if two probes of a run have one name, as topics of ROS have it."""
    from probedesign.live.recordings.schemas import ros_name

    for i, name in enumerate(names):
        if ros_name(name) in map(ros_name, names[:i]):
            raise InputError(f"two probes are named {name}, which is the prefix of their data; deploy one from a "
                             "design with another name")  # fmt: skip


def _frozen_probes(given: Path) -> tuple[Path, list[Path]]:
    """Return the frozen probe, and its calibration if the argument means a folder with nothing but these two."""
    chosen = chosen_exports()
    if not given.exists():
        given = _in_project(EXPORTS / given, given) if chosen is None else chosen / given
    files = sorted(given.glob("*.probe.json"), key=lambda file: len(file.name)) if given.is_dir() else []
    deployed = files[0].name if len(files) == 2 else ""
    if not deployed or files[1].name != deployed.replace(".probe.json", ".calibrated.probe.json"):
        return given, []
    return files[0], files[1:]


def _in_project(path: Path, default: Path) -> Path:
    for folder in (Path.cwd(), *Path.cwd().parents):
        if (folder / path).exists():
            return Path(os.path.relpath(folder / path))
    return default


def _path_of(resolve: Callable[[Path], Path], what: str) -> Parameter:
    def convert(_type: object, tokens: Sequence[Token]) -> Path:
        return resolve(Path(tokens[0].value))

    return Parameter(converter=convert, help=what)


_BUNDLE = "the frozen probe: NAME.probe.json, its folder, or NAME of exports/NAME."
DesignFile = Annotated[Path, _path_of(design_file, "the design file, or its name.")]
FrozenProbe = Annotated[Path, _path_of(frozen_probe, _BUNDLE)]
#: Of `calibrate`, which does without one, and without its calibration.
FrozenProbeIfAny = Annotated[Path | None, _path_of(uncalibrated_probe, f"{_BUNDLE} Not with --tool.")]
JsonOutput = Annotated[bool, Parameter(name="--json", help="print one JSON document.")]
Tare = Literal["auto", "none"]
_ALL_AROUND = tuple(30.0 * k for k in range(12))  #: Directions of the pushes on a curved probe [deg].
_LIST: dict[str, Any] = {"negative": (), "consume_multiple": True}


@Parameter(name="*")
@dataclass
class TaskOptions:
    """Task of `compare`, `sweep` and `optimize`: each place, force, gravity and direction together are one case."""

    force_N: Annotated[list[float] | None, Parameter(name="--force-N", **_LIST)] = None
    """Normal contact force [N], one or several. With several touches it is the force of the strongest; the others are
    evenly spaced below it. Default: 0.005."""
    touches: int = 5
    """Number of touches of one fixed point that are fused while the base presses on. 1 is a single reading."""
    at: Annotated[list[float] | None, Parameter(**_LIST)] = None
    """Touched places as fractions of the length. Default: 0.4, 0.5, ... 0.9."""
    gravity: Annotated[list[str] | None, Parameter(**_LIST)] = None
    """X,Y,Z of gravity in base axes [m/s²], one or several, such as 9.81,0,0. Default: the design's mount."""
    direction: Annotated[list[float] | None, Parameter(**_LIST)] = None
    """Direction in which the object pushes, about the tangent from the section's X axis towards Y [deg], one or
    several. Default: across gravity, or all directions if a probe is curved."""
    combine: Literal["mean", "worst"] = "mean"
    """How the errors of the cases are combined: mean (RMS) or worst."""

    def task(self, curved: bool = False) -> "Task":
        """Return the task; of a curved probe over all directions if none is given.

        Raises:
            InputError: a value is out of range or cannot be read.
        """
        from probedesign.optimization.objective import FRACTIONS, Task

        directions = self.direction or (_ALL_AROUND if curved else ())
        return Task(
            tuple(self.force_N or (0.005,)), self.touches, tuple(self.at or FRACTIONS),
            tuple(map(_vector, self.gravity or [])), tuple(directions), self.combine,
        )  # fmt: skip


def _vector(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--gravity {text!r} cannot be read; write X,Y,Z in m/s², such as 9.81,0,0") from None
    return x, y, z


@Parameter(name="*")
@dataclass
class EstimatorOptions:
    """Estimator of `estimate` and `live`."""

    manifest: Path | None = None
    """manifest.json of the printed parts; its geometry must be the bundle's."""
    exact_model: bool = False
    """Treat probe, mount and bench as exactly known; sensor noise, drift of its bias and the friction prior remain.
    Default: all tolerances of BUNDLE."""
    method: Literal["ml", "force_moment"] = "ml"
    """ml (maximum a posteriori, with friction) or force_moment, the published method."""
    friction: float | None = None
    """Standard deviation of tangential over normal force, instead of BUNDLE's. 0: the force is normal to the surface;
    inf: any direction."""

    def load(self, bundle: Path) -> "Estimator":
        """Return the estimator of a frozen probe.

        The drift of the bias of an exact model still counts: a reading that it alone explains is not located.

        Raises:
            InputError: the file is unreadable, or the friction is NaN or below 0.
        """
        from probedesign.estimation.model import Tolerances
        from probedesign.frozen_probe import load_estimator

        estimator = load_estimator(bundle, self.manifest)
        if self.exact_model:
            estimator = estimator.with_tolerances(Tolerances.exact_probe(estimator.model))
        return estimator if self.friction is None else estimator.with_friction(self.friction)


@Parameter(name="*")
@dataclass
class ReadingOptions:
    """Input of `explore`: a recording or a live source, and how it is processed."""

    tare_s: str | None = None
    """START:END of the tare in seconds after the first reading. The probe must be free then."""
    tare: Tare | None = None
    """Instead of --tare-s: auto takes the first second at rest, when the probe must be free."""
    average: int | None = None
    """Number of readings per mean. Default: by rate and noise of the first readings, so that a mean has the noise that
    BUNDLE states."""
    seconds: float | None = None
    """End this many seconds after the first reading; with --follow after the start."""
    source: str | None = None
    """Live source of one probe instead of a recording, as for `live`. Ends with it, at --seconds or with Ctrl-C."""
    follow: str | None = None
    """Instead of a recording, take the touches of a run of `live --publish udp://HOST:PORT` with poses and a tare, at
    udp://[HOST]:PORT. After each touch the map is printed and, with --publish, sent. Ends at --seconds or with
    Ctrl-C."""
    mend: bool = False
    """Continue with a recording that lacks lines or its end."""
    topic: str = ""
    """Topic of the wrenches in a bag that has several."""
    moment_unit: Literal["Nm", "Nmm"] = "Nm"
    """Unit of the moments in a bag whose publisher does not use N·m."""
    other_probe: bool = False
    """Accept a recording that was made with another probe."""

    def processing(self, recordings: Sequence[Path]) -> "ProcessingOptions | None":
        """Return how the readings are processed; None if they are followed.

        Raises:
            InputError: there is no input, or more than one; there is no tare; or a value is out of range.
        """
        from probedesign.live.processing.chain import ProcessingOptions
        from probedesign.live.processing.tare import parse_tare

        if self.follow is not None:
            if recordings or self.source is not None or self.tare_s is not None or self.tare is not None:
                raise InputError("--follow takes the touches of a run of `live`: no recording, --source or tare")
            if self.average is not None:
                raise InputError("--follow takes the means of the run of `live`: no --average")
            ProcessingOptions(seconds=self.seconds)  # refused alike
            return None
        if bool(recordings) == (self.source is not None):
            raise InputError("explore needs either a recording or --source for a live run, not both")
        if self.tare_s is None and self.tare is None:
            raise InputError(
                "explore needs a tare to separate touches from the sensor's bias. "
                "Add --tare-s START:END, a time when the probe is free, or --tare auto"
            )
        window, zero = parse_tare(self.tare_s, self.tare)
        return ProcessingOptions(window, self.average, seconds=self.seconds, estimates=False, zero=zero)

    def open(
        self, recording: Path | None, model: "ProbeModel", poses: "BasePoses", log: Callable[[str], None]
    ) -> "Source":
        """Return the opened recording, or the live source if `recording` is None.

        Raises:
            InputError: it cannot be opened, or its times are not those of the poses.
        """
        from probedesign.live.sources.replay import RecordingOptions
        from probedesign.live.sources.source import open_source
        from probedesign.mapping.explore import check_poses, load_recording

        if recording is None:
            return open_source(str(self.source), model, log)
        options = RecordingOptions(self.topic, moment_unit=self.moment_unit, other_probe=self.other_probe)
        played = load_recording(recording, model, self.mend, options)
        check_poses(poses, played.blocks)
        return played


@Parameter(name="*")
@dataclass
class BaseOptions:
    """Poses of the base in `explore`, and their uncertainty."""

    pose: list[str] | None = None
    """Poses of the base: FILE.csv or .jsonl, a ROS 2 bag or udp://:PORT, as for `live`. Of several probes one each, in
    their order, or the recording that has those of all. Default: fixed."""
    pose_latency_ms: float = 0.0
    """Delay of a pose relative to a reading of the same time [ms]."""
    gravity_world: str | None = None
    """X,Y,Z of gravity in world axes [m/s²]. Default: 0,0,-9.81."""
    base_offset_mm: float | None = None
    """Standard deviation of the base's position, common to all poses [mm]. Default: base_mm of the design's
    tolerances, or 0.05 (assumed)."""
    base_repeat_mm: float | None = None
    """Standard deviation of the robot's position from pose to pose on each axis [mm]. Default: 0.01 (assumed)."""
    tilt_deg: float | None = None
    """Standard deviation of the base's tilt about its x and y axes, common to all poses [deg]. Default: the design's,
    or 0.2 (assumed)."""
    clocking_deg: float | None = None
    """Standard deviation of the base's rotation about its z axis [deg]. Default: the design's, or 0.5 (assumed)."""

    def priors(self, tolerances: "Tolerances") -> "Tolerances":
        """Return tolerances with the stated uncertainty of the base's pose; raises InputError if it is out of range."""
        from probedesign.mapping.touch_point import BASE_OPTIONS, with_base

        return with_base(tolerances, **{name: getattr(self, name) for name in BASE_OPTIONS})

    def poses(self, log: Callable[[str], None], probes: Sequence[str], probe: str) -> "BasePoses | None":
        """Return the poses of a probe of several, None for a fixed base.

        Args:
            log: takes messages for the user.
            probes: names of all probes.
            probe: name of the probe.

        Raises:
            InputError: the poses cannot be opened, or not every probe has some.
        """
        from probedesign.live.poses.open import open_poses
        from probedesign.live.recordings.schemas import BASE
        from probedesign.live.sources.rosbag import is_bag_path

        given = self.pose or ["fixed"]
        shared = len(given) == 1 < len(probes) and is_bag_path(Path(given[0]))
        if not shared and len(given) != len(probes):
            raise InputError(
                f"{len(given)} --pose for {len(probes)} probe{'s' * (len(probes) > 1)}: give one for each, in their "
                "order, or one recording with the poses of all"
            )
        topic = f"?topic={replace(BASE, probe=probe).path}" if shared else ""
        try:
            return open_poses(
                given[0] + topic if shared else given[probes.index(probe)],
                self.pose_latency_ms,
                self.gravity_world,
                log,
            )
        except InputError as error:
            raise InputError(f"{probe}: {error}" if len(probes) > 1 else str(error)) from None


@Parameter(name="*")
@dataclass
class RehearsalOptions:
    """Simulated run for a first try of `explore`."""

    rehearse: Path | None = None
    """Simulate touches of a card house, write the recording and poses to this folder, and end. The errors and how far
    each card yields are drawn from the bundle's tolerances and the options of the base."""
    seed: int = 1
    """Seed of the drawn errors."""
    friction: float = 0.5
    """Median friction coefficient of the simulated cards; contacts stick and slip. 0 is without friction."""

    def write(self, models: Sequence["ProbeModel"], base: "BaseOptions", one_object: bool, force: bool) -> list[Path]:
        """Simulate the run, write its files and return them; the error of the base's pose is drawn from `base`.

        Several probes touch at the same time, each its side of the house; each has a folder of its own.

        Raises:
            InputError: seed or friction are out of range, a probe cannot touch the house, or files exist already.
        """
        import numpy as np

        from probedesign.estimation.model import Tolerances
        from probedesign.rod.friction import MAX_FRICTION
        from probedesign.simulation.scenes import shared_targets, touch_targets
        from probedesign.simulation.simulated_run import RunErrors, check_run_files, simulate_run, write_run

        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")
        if not 0.0 <= self.friction <= MAX_FRICTION:
            raise InputError(f"--friction {self.friction:g} must lie in 0 ... {MAX_FRICTION:g}")
        folder = self.rehearse or Path()
        folders = [folder / model.name for model in models] if len(models) > 1 else [folder]
        for each in folders:  # before the simulation
            check_run_files(each, force)
        of_cards = np.random.default_rng([self.seed, 1])
        compliance = max(Tolerances.of(model).object_compliance for model in models)
        of_one = compliance * abs(of_cards.normal()) if one_object else None
        targets = touch_targets(lambda: compliance * abs(of_cards.normal()) if of_one is None else of_one)
        with show_progress("simulating touches of a card house"):
            runs = []  # all of them before one is written
            for i, (model, part) in enumerate(zip(models, shared_targets(targets, len(models)), strict=True)):
                rng = np.random.default_rng([self.seed, 1 + i] if i else self.seed)
                priors = base.priors(Tolerances.of(model))
                errors = RunErrors.from_priors(priors, self.friction)
                runs.append((simulate_run(model, part, rng, errors), model, folders[i], rng, force))
            return [path for run in runs for path in write_run(*run)]


@Parameter(name="*")
@dataclass
class SuggestionOptions:
    """A known object and the next touch."""

    publish: str | None = None
    """Send shapes and next touch as a JSON datagram to udp://HOST:PORT, or as messages to the node of ROS 2 at
    ros2://HOST:PORT."""

    suggest: bool = False
    """Print the touch that is expected to improve the goal most, with the pose of the base."""
    goal: str = "shapes"
    """shapes (the one that is known worst), extent (of an edge or a plane), pose (of --object) or stiffness (of
    --one-object)."""
    force_limit_mN: Annotated[float, Parameter(name="--force-limit-mN")] = 4.0
    """Largest force on the object [mN]; less where an object as soft as the design's prior would yield by 2 mm."""
    object: Path | None = None
    """Mesh of the touched object, in mm, closed: STL, OBJ, PLY or what trimesh reads. Its pose is estimated."""
    object_at: str = ""
    """First guess of its pose in the world: x,y,z in mm, or x,y,z,qx,qy,qz,qw, as --object-at=-30,0,45."""
    object_std_mm: float = 10.0
    """Standard deviation of the first guess of its position, on each axis [mm]."""
    object_std_deg: float = 10.0
    """Standard deviation of the first guess of its rotation, about each axis [deg]."""

    def check(self) -> "KnownObject | None":
        """Return the object of the mesh, None where none is given, before the recording is read.

        Raises:
            InputError: an option is out of range, the mesh cannot be read or is not closed, or trimesh is missing.
        """
        from probedesign.mapping.known_object import KnownObject, parse_pose
        from probedesign.mapping.next_touch import GOALS

        if self.goal not in GOALS:
            raise InputError(f"--goal {self.goal} is unknown; available are {', '.join(GOALS)}")
        if not 0.1 <= self.force_limit_mN <= 1000.0:
            raise InputError(f"--force-limit-mN {self.force_limit_mN:g} must lie in 0.1 ... 1000")
        if (self.object is None) != (not self.object_at):
            raise InputError("--object and --object-at belong together: the mesh and the first guess of its pose")
        if self.goal == "pose" and self.object is None:
            raise InputError("--goal pose needs --object and --object-at")
        if not (0.0 < self.object_std_mm <= 100.0 and 0.0 < self.object_std_deg <= 60.0):
            raise InputError("--object-std-mm must lie in 0 ... 100, --object-std-deg in 0 ... 60, both above 0")
        if self.object is None:
            return None
        parse_pose(self.object_at)
        if not self.object.is_file():
            raise InputError(f"--object {self.object}: no such file")
        return KnownObject.load(self.object)

    def located(self, known: "KnownObject", touches: "TouchSet", friction: float) -> "ObjectPose":
        """Return the pose of the object by touches."""
        from probedesign.mapping.known_object import ObjectPose, locate_object, parse_pose

        guess = ObjectPose.prior(
            parse_pose(self.object_at), 1e-3 * self.object_std_mm, math.radians(self.object_std_deg)
        )
        return locate_object(touches, known, guess, friction)
