"""The frozen probe: all that `estimate` and `live` need of a probe, in one JSON file that people can read.

`freeze` writes the model of a probe as plain data, `load_model` and `load_estimator` check a file and read it back.
"""

import hashlib
import json
import math
from dataclasses import asdict, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, get_args

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array, is_pose
from probedesign.design.catalog import ELASTIC_FRICTION, Provenance, Quantity
from probedesign.design.sensors import NANO17, Noise
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.geometry import Flange, ProbeGeometry
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection
from probedesign.geometry.mass import MassProperties
from probedesign.rod.rod import Rod

KIND = "probedesign frozen probe"
SCHEMA = 3
FRICTIONLESS_SCHEMA = 2
"""Older schema that is still read: without `contact` and with fewer tolerances (`NEW_TOLERANCES`)."""
ROUND_SCHEMA = 1
"""Older schema that is still read: as schema 2, with full round sections and one second moment for all directions."""
NEW_TOLERANCES = ("root_radii", "gain", "stiffness_scatter", "walk_steps")
"""Tolerances that files of the older schemas lack; they take their defaults and are listed as assumed."""
SECTION_STATIONS = 17
"""Number of equidistant stations of the section table, beside the knots; for people and for the check on load."""
_UNITS = {"youngs_modulus": "Pa", "shear_modulus": "Pa", "density": "kg_m3"}
_MAX_BYTES = 10_000_000


def freeze(model: ProbeModel) -> dict[str, Any]:
    """Return the frozen probe as plain data with its checksum.

    Args:
        model: of the probe, `Probe.model`.
    """
    rod = model.rod
    data: dict[str, Any] = {
        "kind": KIND,
        "schema": SCHEMA,
        "written_by": f"probedesign {_version()}",
        "name": model.name,
        "fingerprint": model.fingerprint,
        "assumptions": list(model.assumptions),
        "rod": {
            "s_m": rod.s.tolist(),
            "radius_m": rod.radius.tolist(),
            "section": {
                "bore_ratio": model.cross_section.bore_ratio,
                "flatness": model.cross_section.flatness,
            },
            "rigid_length_m": rod.rigid_length,
            "finite_strain": rod.finite_strain,
            "shear_coefficient": rod.shear_coefficient,
            **({} if rod.rounded_from is None else {"rounded_from_m": rod.rounded_from}),
        },
        "flange": {"diameter_m": model.flange.diameter, "thickness_m": model.flange.thickness},
        "material": {
            f"{name}_{_UNITS[name]}": {"value": q.value, "provenance": q.provenance, "source": q.source}
            for name, q in model.material.items()
        },
        "contact": {
            "friction": "inf" if math.isinf(model.friction) else model.friction,
            "provenance": model.friction_provenance,
            "source": model.friction_source,
        },
        "spread": {"stiffness": model.stiffness_spread, "creep": model.creep_spread},
        "tolerances": asdict(Tolerances.of(model)),
        "sections": _sections(rod),
        "flexible_mass_kg": model.mass,
        "hanging": {
            "frame": "sensor",
            "volume_m3": model.payload.volume,
            "mass_kg": model.payload.mass,
            "p_com_m": model.payload.p_com.tolist(),
            "inertia_kg_m2": model.payload.inertia.tolist(),
        },
        "T_sensor_base": model.T_sensor_base.tolist(),
        "gravity_base_m_s2": model.gravity_base.tolist(),
        "sensor": {
            "force_range_N": model.wrench_range[:3].tolist(),
            "moment_range_Nm": model.wrench_range[3:].tolist(),
            "noise_force_N": model.noise.force,
            "noise_moment_Nm": model.noise.moment,
            **({} if model.noise.is_isotropic else {"noise_cov": model.noise.cov.tolist()}),
            "averaging_samples": model.averaging_samples,
            "model": model.sensor,
        },
    }
    return {**data, "checksum": _checksum(data)}


def write_frozen(model: ProbeModel, path: Path) -> None:
    """Write the frozen probe atomically; an existing file is replaced."""
    write_atomically(path, (json.dumps(freeze(model), indent=2) + "\n").encode())


def load_estimator(path: str | Path, manifest: str | Path | None = None, *, exact: bool = False) -> Estimator:
    """Return the estimator of a frozen probe.

    Args:
        path: `NAME.probe.json`.
        manifest: of the printed parts, to check against; if None, a `manifest.json` beside the file is checked.
        exact: take probe, mount, bench and bias as exactly known, so that the sensor's noise and the prior on friction
            alone remain; otherwise all error sources of the tolerances of the probe are included.

    Raises:
        InputError: the file is unreadable, altered, of another schema, or not of the printed parts.
    """
    return Estimator(load_model(path, manifest), Tolerances.none() if exact else None)


def load_model(path: str | Path, manifest: str | Path | None = None) -> ProbeModel:
    """Return the model of a frozen probe; see `load_estimator` for arguments and errors."""
    path = Path(path)
    data = _read_json(path, "frozen probe")
    _check_identity(data, path)
    try:
        data = _upgraded(data)
        model = _model_of(data)
        _check_sections(data, model.rod)
    except InputError as error:
        raise InputError(f"{path}: {error}; deploy it again") from None
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(
            f"{path}: not a complete frozen probe ({type(error).__name__}: {error}); deploy it again"
        ) from None
    beside = path.parent / "manifest.json"
    for found in [Path(manifest)] if manifest is not None else [beside] if beside.exists() else []:
        check_manifest(model.fingerprint, found)
    return model


def check_manifest(fingerprint: str, manifest: Path) -> None:
    """Check that a geometry is that of the exported parts.

    Raises:
        InputError: the manifest is unreadable or of another geometry.
    """
    printed = _read_json(manifest, "manifest").get("fingerprint")
    if printed != fingerprint:
        raise InputError(
            f"{manifest}: the parts there have fingerprint {printed}, the probe has {fingerprint}; "
            "export the design again, or use the frozen probe that belongs to the printed part"
        )


def check_replaceable(path: Path) -> None:
    """Check that a path is free or holds a frozen probe, which may be replaced.

    Raises:
        InputError: another file or a folder has that name.
    """
    if path.exists() and (path.is_dir() or _read_json(path, "frozen probe").get("kind") != KIND):
        raise InputError(f"{path}: is not a frozen probe, so it is not replaced; name another file")


def _check_identity(data: dict[str, Any], path: Path) -> None:
    if data.get("kind") != KIND:
        raise InputError(f"{path}: not a frozen probe; make one with: probedesign deploy DESIGN")
    if data.get("schema") not in (SCHEMA, FRICTIONLESS_SCHEMA, ROUND_SCHEMA):
        known = f"this version reads {ROUND_SCHEMA} to {SCHEMA}"
        raise InputError(f"{path}: schema {data.get('schema')} is not known here ({known})")
    body = {key: value for key, value in data.items() if key != "checksum"}
    if data.get("checksum") != _checksum(body):
        raise InputError(f"{path}: does not match its own checksum; it was altered or cut: deploy it again")


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a file of any schema in the current schema.

    Values that an older schema lacks take their defaults; numbers among them are added to the assumptions.
    """
    if data["schema"] == SCHEMA:
        return data
    if data["schema"] == ROUND_SCHEMA:
        table = data["sections"]
        data = {
            **data,
            "rod": {**data["rod"], "section": asdict(FULL_ROUND), "finite_strain": False},
            "sections": {**table, **{name: table[old] for name, old in _ROUND_NAMES.items()}},
        }
    friction = ELASTIC_FRICTION
    contact = {"friction": friction.value, "provenance": friction.provenance, "source": friction.source}
    tolerances = data.get("tolerances")
    if tolerances is not None:
        added = {name: getattr(Tolerances, name) for name in (*NEW_TOLERANCES, "youngs_modulus_by_diameter")}
        tolerances = {**added, **tolerances}
    assumed = ["contact.friction", *(f"tolerances.{name}" for name in NEW_TOLERANCES)]
    return {
        **data,
        "assumptions": [*data["assumptions"], *assumed],
        "contact": contact,
        "spread": data.get("spread", {"stiffness": None, "creep": 0.0}),
        "tolerances": tolerances,
    }


def _model_of(data: dict[str, Any]) -> ProbeModel:
    """Return the model that the content of a file describes; the inverse of `freeze`."""
    material = {name: Quantity(**data["material"][f"{name}_{unit}"]) for name, unit in _UNITS.items()}
    rod, hanging, sensor = data["rod"], data["hanging"], data["sensor"]
    section = _section(rod["section"])
    model = ProbeModel(
        name=str(data["name"]),
        fingerprint=str(data["fingerprint"]),
        flange=Flange(*map(float, (data["flange"]["diameter_m"], data["flange"]["thickness_m"]))),
        rod=Rod(
            s=_numbers(rod["s_m"]),
            radius=_numbers(rod["radius_m"]),
            youngs_modulus=material["youngs_modulus"].value,
            shear_modulus=material["shear_modulus"].value,
            density=material["density"].value,
            shear_coefficient=rod["shear_coefficient"],
            rigid_length=rod["rigid_length_m"],
            factors=section.factors,
            finite_strain=rod["finite_strain"] is True,
            rounded_from=None if rod.get("rounded_from_m") is None else float(rod["rounded_from_m"]),
        ),
        gravity_base=_numbers(data["gravity_base_m_s2"], 3),
        T_sensor_base=_numbers(data["T_sensor_base"], 4, 4),
        payload=MassProperties(
            hanging["volume_m3"],
            hanging["mass_kg"],
            _numbers(hanging["p_com_m"], 3),
            _numbers(hanging["inertia_kg_m2"], 3, 3),
        ),
        wrench_range=np.concatenate(
            [_numbers(sensor["force_range_N"], 3), _numbers(sensor["moment_range_Nm"], 3)]
        ),
        noise=_noise(sensor),
        sensor=str(sensor.get("model", NANO17.name)),
        averaging_samples=int(sensor["averaging_samples"]),
        material=material,
        assumptions=tuple(data["assumptions"]),
        cross_section=section,
        tolerances=_tolerances(data["tolerances"], data["schema"]),
        **_contact(data["contact"]),
        **_spread(data["spread"]),
    )
    geometry = ProbeGeometry(model.rod.s, model.rod.radius, model.flange, section)
    if geometry.fingerprint != model.fingerprint:
        raise InputError(
            f"fingerprint {model.fingerprint} is not that of the geometry ({geometry.fingerprint})"
        )
    if not (0.0 <= float(model.payload.mass) < 10.0 and model.averaging_samples >= 1):
        raise InputError("hanging.mass_kg or sensor.averaging_samples is out of range")
    if not is_pose(model.T_sensor_base):
        raise InputError("T_sensor_base is not a rigid pose")
    if not (model.wrench_range > 0).all():
        raise InputError("sensor: ranges and noise must be positive")
    return model


def _noise(sensor: dict[str, Any]) -> Noise:
    """Return the noise of one reading: one σ for forces and one for moments, unless a covariance is given."""
    force, moment = sensor["noise_force_N"], sensor["noise_moment_Nm"]
    if not (0 < force < math.inf and 0 < moment < math.inf):
        raise InputError("sensor: ranges and noise must be positive")
    if "noise_cov" not in sensor:
        return Noise.isotropic(force, moment)
    cov = _numbers(sensor["noise_cov"], 6, 6)
    if not (np.array_equal(cov, cov.T) and np.linalg.eigvalsh(cov)[0] > 0.0):
        raise InputError("sensor.noise_cov must be symmetric and positive definite")
    return Noise(cov)


def _contact(data: dict[str, Any]) -> dict[str, Any]:
    """Return the friction with its provenance; JSON has no infinity, which is the text "inf"."""
    value, provenance = data["friction"], data["provenance"]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if value != "inf" and not (number and 0.0 <= value < math.inf):
        raise InputError(f'contact.friction = {str(value)[:60]!a} must be a number of 0 or greater, or "inf"')
    if provenance not in get_args(Provenance):
        raise InputError(f"contact.provenance must be one of {', '.join(get_args(Provenance))}")
    return {
        "friction": float(value),
        "friction_provenance": provenance,
        "friction_source": str(data["source"]),
    }


def _spread(data: dict[str, Any]) -> dict[str, Any]:
    """Return the priors of the material."""
    stiffness, creep = data["stiffness"], float(data["creep"])
    spreads = [creep] if stiffness is None else [float(stiffness), creep]
    if not all(0.0 <= spread <= 0.5 for spread in spreads):
        raise InputError(f"spread: {spreads} must lie in 0 ... 0.5")
    return {"stiffness_spread": None if stiffness is None else float(stiffness), "creep_spread": creep}


def _tolerances(data: dict[str, Any] | None, schema: int) -> Tolerances | None:
    """Return the tolerances; None for a file of a time before they were frozen."""
    if data is None and schema != SCHEMA:
        return None
    known = {entry.name for entry in fields(Tolerances)}
    if not isinstance(data, dict) or set(data) != known or not isinstance(data["tared"], bool):
        raise InputError(f"tolerances: must hold {', '.join(sorted(known))}")
    spreads: dict[str, Any] = {name: float(value) for name, value in data.items() if name != "tared"}
    return Tolerances(**spreads, tared=data["tared"])


def _section(data: dict[str, Any]) -> CrossSection:
    return CrossSection(float(data["bore_ratio"]), float(data["flatness"]))


def _numbers(values: Any, *shape: int) -> Array:
    array = np.array(values, dtype=float)
    if not np.isfinite(array).all() or (shape and array.shape != shape):
        raise InputError(f"expected finite numbers of shape {shape or 'any'}, found {str(values)[:60]}")
    return array


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


_ROUND_NAMES = {
    "second_moment_xx_m4": "second_moment_m4",
    "second_moment_yy_m4": "second_moment_m4",
    "torsion_constant_m4": "polar_moment_m4",
    "EI_xx_Nm2": "EI_Nm2",
    "EI_yy_Nm2": "EI_Nm2",
}
"""Names of these columns in files of the round schema."""


def _check_sections(data: dict[str, Any], rod: Rod) -> None:
    for name, values in _sections(rod).items():
        # JSON keeps doubles to the last digit; 1e-12 allows for another libm.
        if not np.allclose(_numbers(data["sections"][name]), values, rtol=1e-12, atol=0.0):
            raise InputError(f"sections.{name} does not follow from the rod")


def _read_json(path: Path, what: str) -> dict[str, Any]:
    try:
        whole = path.stat().st_size <= _MAX_BYTES
        data = json.loads(path.read_text(encoding="utf-8")) if whole else None
    except FileNotFoundError:
        raise InputError(f"{path}: no such {what}") from None
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


def _version() -> str:
    try:
        return version("probedesign")
    except PackageNotFoundError:
        return "(not installed)"
