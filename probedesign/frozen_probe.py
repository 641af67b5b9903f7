"""The frozen probe: all that `estimate` and `live` need of a probe, in one JSON file that people can read.

`FIELDS` is the file format: one row for each value, with its key and the attribute of `ProbeModel` that has it.
`freeze` writes a model by this table, and `load_model` reads one back.
"""

import hashlib
import json
import math
from collections import ChainMap
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from probedesign.core.errors import InputError, quoted
from probedesign.core.files import check_regular, file_in, is_plain_name, write_atomically
from probedesign.core.frames import Array, is_pose
from probedesign.design.catalog import Provenance, Quantity
from probedesign.design.sensors import Noise
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.geometry import Axis, Flange, ProbeGeometry
from probedesign.geometry.cross_section import CrossSection
from probedesign.geometry.mass import MassProperties
from probedesign.rod.rod import Rod

KIND = "probedesign frozen probe"
SCHEMA = 6  #: Version of the file format; no other one is read.
#: Number of equidistant stations of the section table, beside the knots; for people and for the check on load.
SECTION_STATIONS = 17
_MAX_BYTES = 10_000_000
MAX_TEXT = 500  #: Maximum length of a text.


# The table


class Field(NamedTuple):
    """One value of the file."""

    key: str  #: its place in the file, with the unit.
    attribute: str  #: of `ProbeModel`, in SI units, or a value that `freeze` computes.
    #: checks the value of the file and returns that of the model; its errors begin after the key. None: the value is
    #: written for people and not read.
    read: Callable[[Any], Any] | None
    optional: bool = False  #: a file lacks it where it is None.


def _array(*shape: int) -> Callable[[Any], Array]:
    """Return the check of a finite array of a shape; without one it may have any."""

    def read(values: Any) -> Array:
        array = np.array(values, dtype=float)
        if not np.isfinite(array).all() or (shape and array.shape != shape):
            raise InputError(f"must be finite numbers of shape {shape or 'any'}, found {str(values)[:60]}")
        return array

    return read


def _number(lowest: float = -math.inf, highest: float = math.inf) -> Callable[[Any], float]:
    def read(value: Any) -> float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and lowest <= value <= highest and math.isfinite(value)):
            limits = f"of {lowest:g} or greater" if math.isinf(highest) else f"in {lowest:g} ... {highest:g}"
            raise InputError(f"= {str(value)[:60]!a} must be a number {limits}")
        return float(value)

    return read


def _read_name(value: Any) -> str:
    """A name becomes part of the names of recordings: a forged one must not lead out of their folder."""
    if not isinstance(value, str) or not is_plain_name(value):
        raise InputError(f"= {str(value)[:60]!a} is not a plain name; letters, digits, '-', '_' and '.' are allowed")
    return value


def _read_text(value: Any) -> str:
    """A text is printed on terminals and pages: a forged one must not control them."""
    if not isinstance(value, str) or not value.isprintable() or len(value) > MAX_TEXT:
        raise InputError(f"= {str(value)[:60]!a} must be a text of up to {MAX_TEXT} printable characters")
    return value


def _read_texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise InputError("must be a list of texts")
    return tuple(map(_read_text, values))


def _read_parts(values: Any) -> dict[str, str]:
    if not isinstance(values, dict):
        raise InputError("must be fingerprints by part")
    return {_read_name(name): _read_text(value) for name, value in values.items()}


def _read_friction(value: Any) -> float:
    """JSON has no infinity, which is the text "inf"."""
    return math.inf if value == "inf" else _number(0.0)(value)


def _read_provenance(value: Any) -> Any:
    if value not in get_args(Provenance):
        raise InputError(f"must be one of {', '.join(get_args(Provenance))}")
    return value


def _read_pose(values: Any) -> Array:
    T = _array(4, 4)(values)
    if not is_pose(T):
        raise InputError("is not a rigid pose")
    return T


def _read_cov(values: Any) -> Array:
    cov = _array(6, 6)(values)
    if not (np.array_equal(cov, cov.T) and np.linalg.eigvalsh(cov)[0] > 0.0):
        raise InputError("must be symmetric and positive definite")
    return cov


def _read_flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError("must be true or false")
    return value


NUMBER, POSITIVE, SPREAD = _number(), _number(math.ulp(0.0)), _number(0.0, 0.5)
_UNITS = {"youngs_modulus": "Pa", "shear_modulus": "Pa", "density": "kg_m3"}
_QUANTITY: dict[str, Callable[[Any], Any]] = {"value": NUMBER, "provenance": _read_text, "source": _read_text}
#: Values of the file, in its order.
FIELDS = (
    Field("name", "name", _read_name),
    Field("fingerprint", "fingerprint", _read_text),
    Field("parts", "parts", _read_parts),
    Field("assumptions", "assumptions", _read_texts),
    Field("rod.s_m", "rod.s", _array()),
    Field("rod.radius_m", "rod.radius", _array()),
    Field("rod.section.bore_ratio", "cross_section.bore_ratio", NUMBER),
    Field("rod.section.flatness", "cross_section.flatness", NUMBER),
    Field("rod.rigid_length_m", "rod.rigid_length", NUMBER),
    Field("rod.finite_strain", "rod.finite_strain", _read_flag),
    Field("rod.shear_coefficient", "rod.shear_coefficient", NUMBER),
    Field("rod.rounded_from_m", "rod.rounded_from", NUMBER, optional=True),
    Field("rod.rest_curvature_1_m", "rod.rest_curvature", _array(), optional=True),  # `Rod` checks the shape
    Field("axis.s_m", "axis_s", _array(), optional=True),  # `Axis` checks the shapes
    Field("axis.curvature_1_m", "axis_curvature", _array(), optional=True),
    Field("flange.diameter_m", "flange.diameter", NUMBER),
    Field("flange.thickness_m", "flange.thickness", NUMBER),
    *(
        Field(f"material.{name}_{unit}.{part}", f"material.{name}.{part}", read)
        for name, unit in _UNITS.items()
        for part, read in _QUANTITY.items()
    ),
    Field("contact.friction", "friction", _read_friction),
    Field("contact.provenance", "friction_provenance", _read_provenance),
    Field("contact.source", "friction_source", _read_text),
    Field("spread.stiffness", "stiffness_spread", lambda value: None if value is None else SPREAD(value)),
    Field("spread.creep", "creep_spread", SPREAD),
    *(  # `Tolerances` checks the ranges
        Field(f"tolerances.{name}", f"tolerances.{name}", _read_flag if isinstance(default, bool) else NUMBER)
        for name, default in asdict(Tolerances()).items()
    ),
    Field("sections", "sections", None),
    Field("flexible_mass_kg", "mass", None),
    Field("hanging.frame", "frame", None),
    Field("hanging.volume_m3", "payload.volume", NUMBER),
    Field("hanging.mass_kg", "payload.mass", _number(0.0, 10.0)),
    Field("hanging.p_com_m", "payload.p_com", _array(3)),
    Field("hanging.inertia_kg_m2", "payload.inertia", _array(3, 3)),
    Field("T_sensor_base", "T_sensor_base", _read_pose),
    Field("T_robotflange_base", "T_robotflange_base", _read_pose, optional=True),
    Field("gravity_base_m_s2", "gravity_base", _array(3)),
    Field("sensor.force_range_N", "force_range", _array(3)),
    Field("sensor.moment_range_Nm", "moment_range", _array(3)),
    Field("sensor.noise_force_N", "noise.force", POSITIVE),
    Field("sensor.noise_moment_Nm", "noise.moment", POSITIVE),
    Field("sensor.noise_cov", "noise_cov", _read_cov, optional=True),
    Field("sensor.averaging_samples", "averaging_samples", int),
    Field("sensor.model", "sensor", _read_text),
    Field("sensor.body_d_m", "sensor_d", _number(1e-3, 1.0)),
    Field("sensor.height_m", "sensor_height", _number(1e-3, 1.0)),
    Field("identified_tests", "identified_tests", _read_texts),
)


# Writing


def freeze(model: ProbeModel) -> dict[str, Any]:
    """Return the frozen probe as plain data with its checksum.

    Args:
        model: of the probe, `Probe.model`.
    """
    computed = {
        "tolerances": asdict(Tolerances.of(model)),
        "sections": _sections(model.rod),
        "mass": model.mass,
        "frame": "sensor",
        "force_range": model.wrench_range[:3],
        "moment_range": model.wrench_range[3:],
        "axis_s": None if model.axis is None else model.axis.s,
        "axis_curvature": None if model.axis is None else model.axis.curvature,
        "noise_cov": None if model.noise.is_isotropic else model.noise.cov,
    }
    try:
        installed = version("probedesign")
    except PackageNotFoundError:
        installed = "(not installed)"
    data: dict[str, Any] = {"kind": KIND, "schema": SCHEMA, "written_by": f"probedesign {installed}"}
    for field in FIELDS:
        value: Any = ChainMap(computed, vars(model))
        for name in field.attribute.split("."):
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
        if value is None and field.optional:
            continue
        *tables, key = field.key.split(".")
        table = data
        for name in tables:
            table = table.setdefault(name, {})
        table[key] = _plain(value)
    return {**data, "checksum": _checksum(data)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return list(value)
    return "inf" if value == math.inf else value


def deploy_model(model: ProbeModel, path: Path) -> Path:
    """Write the frozen probe and return its file, which may replace a frozen probe only.

    Args:
        model: to freeze.
        path: a file, or a folder: one that exists, or a name that does not end in .json.

    Raises:
        InputError: another file has that name, or the parts exported beside it have another geometry.
    """
    if path.is_dir() or (path.suffix != ".json" and not path.exists()):
        path /= f"{model.name}.probe.json"
    if path.exists() and (path.is_dir() or _read_json(path, "frozen probe").get("kind") != KIND):
        raise InputError(f"{path}: is not a frozen probe, so it is not replaced; name another file")
    manifest = path.parent / "manifest.json"
    if manifest.exists():
        check_manifest(model.parts or {"probe": model.fingerprint}, manifest)
    write_frozen(model, path)
    return path


def write_frozen(model: ProbeModel, path: Path) -> None:
    """Write the frozen probe atomically; an existing file is replaced."""
    write_atomically(path, (json.dumps(freeze(model), indent=2) + "\n").encode())


# Reading


def load_estimator(path: str | Path, manifest: str | Path | None = None, *, exact: bool = False) -> Estimator:
    """Return the estimator of a frozen probe.

    Args:
        path: `NAME.probe.json`, or a folder with one such file.
        manifest: of the printed parts, to check against; if None, a `manifest.json` beside the file is checked.
        exact: take probe, mount, bench and bias as exactly known, so that the sensor's noise and the prior on friction
            alone remain; otherwise all error sources of the tolerances of the probe are included.

    Raises:
        InputError: the file is unreadable, altered, of another schema, or not of the printed parts.
    """
    return Estimator(load_model(path, manifest), Tolerances.none() if exact else None)


def load_model(path: str | Path, manifest: str | Path | None = None) -> ProbeModel:
    """Return the model of a frozen probe; see `load_estimator` for arguments and errors."""
    path = file_in(Path(path), "*.probe.json", "frozen probe")
    if path.suffix == ".toml":
        raise InputError(f"{path}: is a design; freeze it with: probedesign deploy {path}, and give the file it writes")
    data = _read_json(path, "frozen probe")
    _check_identity(data, path)
    try:
        model = _model_of(data)
        for name, values in _sections(model.rod).items():
            # JSON keeps doubles to the last digit; 1e-12 allows for another libm.
            if not np.allclose(_array()(data["sections"][name]), values, rtol=1e-12, atol=0.0):
                raise InputError(f"sections.{name} does not follow from the rod")
    except InputError as error:
        raise InputError(f"{path}: {error}; deploy it again") from None
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(
            f"{path}: not a complete frozen probe ({type(error).__name__}: {error}); deploy it again"
        ) from None
    beside = path.parent / "manifest.json"
    for checked in [Path(manifest)] if manifest is not None else [beside] if beside.exists() else []:
        check_manifest(model.parts or {"probe": model.fingerprint}, checked)
    return model


def check_manifest(expected: Mapping[str, str], manifest: Path) -> None:
    """Check that exported parts are those of a probe: its geometry, each part of its mount and the payload.

    Args:
        expected: fingerprints by name, as of `Mount.fingerprints`.
        manifest: of the parts.

    Raises:
        InputError: the manifest is unreadable, or a part or the payload is another; the message names them.
    """
    if stale := stale_parts(expected, _read_json(manifest, "manifest")):
        raise InputError(
            f"{manifest}: {stale}; export the design again, or use the frozen probe that belongs to the printed parts"
        )


def stale_parts(expected: Mapping[str, str], manifest: Mapping[str, Any]) -> str:
    """Return which parts of a manifest are not the expected ones, with both fingerprints; empty if all are.

    Args:
        expected: fingerprints by name, as of `Mount.fingerprints`.
        manifest: of an export or of changed parts.
    """
    stated = manifest.get("fingerprints", {"probe": manifest.get("fingerprint")})
    known = expected if "kind" in manifest else {name: expected[name] for name in expected if name in stated}
    others = [f"the {name.replace('_', ' ')} there has fingerprint {stated.get(name)}, this design has {digits}"
              for name, digits in known.items() if stated.get(name) != digits]  # fmt: skip
    return ", ".join(others)


def _check_identity(data: dict[str, Any], path: Path) -> None:
    if data.get("kind") != KIND:
        raise InputError(f"{path}: not a frozen probe; make one with: probedesign deploy DESIGN")
    if data.get("schema") != SCHEMA:
        raise InputError(
            f"{path}: schema {quoted(data.get('schema'))} is not known, this version reads {SCHEMA}; "
            "make the file again with: probedesign deploy DESIGN"
        )
    body = {key: value for key, value in data.items() if key != "checksum"}
    if data.get("checksum") != _checksum(body):
        raise InputError(f"{path}: does not match its own checksum; it was altered or cut: deploy it again")


def _model_of(data: dict[str, Any]) -> ProbeModel:
    """Return the model that the content of a file describes; the inverse of `freeze`."""
    values = {}
    for field in FIELDS:
        if field.read is None:
            continue
        value: Any = data
        for name in field.key.split("."):
            if field.optional and name not in value:
                value = None
                break
            value = value[name]
        else:
            try:
                value = field.read(value)
            except InputError as error:
                raise InputError(f"{field.key} {error}") from None
        values[field.attribute] = value
    unknown = set(data["tolerances"]) - {entry.name for entry in fields(Tolerances)}
    if unknown:
        raise InputError(f"tolerances: {', '.join(sorted(unknown))} is not known")

    def part(head: str) -> dict[str, Any]:
        start = f"{head}."
        return {name.removeprefix(start): value for name, value in values.items() if name.startswith(start)}

    material = {name: Quantity(**part(f"material.{name}")) for name in _UNITS}
    section = CrossSection(**part("cross_section"))
    stiffness: dict[str, Any] = {name: quantity.value for name, quantity in material.items()}
    top = {name: value for name, value in values.items() if "." not in name}
    wrench_range = np.concatenate([top.pop("force_range"), top.pop("moment_range")])
    noise_cov, axis_s, axis_curvature = (top.pop(name) for name in ("noise_cov", "axis_s", "axis_curvature"))
    axis = None if axis_s is None or axis_curvature is None else Axis(axis_s, axis_curvature)
    model = ProbeModel(
        **top,
        flange=Flange(**part("flange")),
        rod=Rod(**part("rod"), **stiffness, factors=section.factors),
        payload=MassProperties(**part("payload")),
        wrench_range=wrench_range,
        noise=Noise.isotropic(**part("noise")) if noise_cov is None else Noise(noise_cov),
        material=material,
        cross_section=section,
        axis=axis,
        tolerances=Tolerances(**part("tolerances")),
    )
    geometry = ProbeGeometry(model.rod.s, model.rod.radius, model.flange, section, curved=axis)
    if geometry.fingerprint != model.fingerprint:
        raise InputError(f"fingerprint {model.fingerprint} is not that of the geometry ({geometry.fingerprint})")
    if model.averaging_samples < 1 or not (wrench_range > 0).all():
        raise InputError("sensor: ranges and averaging_samples must be positive")
    return model


def _sections(rod: Rod) -> dict[str, list[float]]:
    """Return section properties along s for people and for the check on load; xx bends about x, yy about y."""
    s = np.unique(np.concatenate([rod.s, np.linspace(0.0, rod.length, SECTION_STATIONS)]))
    r = rod.radius_at(s)
    of_area, of_xx, of_yy, of_torsion = rod.factors
    area, xx, yy = of_area * np.pi * r**2, of_xx * np.pi / 4.0 * r**4, of_yy * np.pi / 4.0 * r**4
    torsion = of_torsion * np.pi / 2.0 * r**4
    return {
        "s_m": s.tolist(),
        "area_m2": area.tolist(),
        "second_moment_xx_m4": xx.tolist(),
        "second_moment_yy_m4": yy.tolist(),
        "torsion_constant_m4": torsion.tolist(),
        "EA_N": (rod.youngs_modulus * area).tolist(),
        "GA_N": (rod.shear_coefficient * rod.shear_modulus * area).tolist(),
        "EI_xx_Nm2": (rod.youngs_modulus * xx).tolist(),
        "EI_yy_Nm2": (rod.youngs_modulus * yy).tolist(),
        "GJ_Nm2": (rod.shear_modulus * torsion).tolist(),
    }


def _read_json(path: Path, what: str) -> dict[str, Any]:
    check_regular(path)
    try:
        whole = path.stat().st_size <= _MAX_BYTES
        data = json.loads(path.read_text(encoding="utf-8")) if whole else None
    except FileNotFoundError:
        remedy = "; make it with: probedesign deploy DESIGN" if what == "frozen probe" else ""
        raise InputError(f"{path}: no such {what}{remedy}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not a {what}: not valid JSON") from None
    if not whole:
        raise InputError(f"{path}: is too large for a {what}")
    if not isinstance(data, dict):
        raise InputError(f"{path}: is not a {what}")
    return data


def _checksum(data: dict[str, Any]) -> str:
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
