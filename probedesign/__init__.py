"""Design, print and run soft conic probes that locate a touch from the wrench at their base.

The usual way through the package::

    design = probedesign.load_design("designs/large.toml")        # Design, or new(length_mm=150, base_d_mm=12)
    probe = probedesign.build_probe(design)                       # Probe: geometry, sections, mass
    equilibrium = probe.solve(force_base=(0.01, 0.0, 0.0))        # Equilibrium of its Rod
    prediction = probe.predict()                                  # Prediction: expected contact error
    estimator = probe.estimator()                                 # Estimator, or load_estimator(path)
    estimate = estimator.estimate(equilibrium.wrench_base)        # Estimate: contact and covariance

`read_campaign` reads the measurements of a print, `identify` estimates its parameters from them, and `validate`
compares an estimator with a reference. Lengths are in metres, forces in newtons, moments in newton metres; a name ends
in its unit where that is another. Each name is imported when it is first used, so that `import probedesign` stays fast.
"""

from probedesign.core.notebook import set_views as _set_views

TYPE_CHECKING = False  # as in typing, whose import would delay the first Ctrl-C that ends a command in one line
if TYPE_CHECKING:
    from typing import Any

    from probedesign.campaigns import Campaign, read_campaign
    from probedesign.core.errors import InputError
    from probedesign.design import Design, check_design, load_design, new, parse_design
    from probedesign.design.catalog import Resin
    from probedesign.design.sensors import Noise
    from probedesign.design.sensors import SensorModel as Sensor
    from probedesign.estimation.detector import Detector
    from probedesign.estimation.estimate import Estimate, FusedEstimate
    from probedesign.estimation.estimator import Estimator
    from probedesign.estimation.model import Tolerances
    from probedesign.estimation.model import Tolerances as Priors
    from probedesign.estimation.tracker import Tracker
    from probedesign.frozen_probe import load_estimator
    from probedesign.geometry import CrossSection
    from probedesign.identification.identify import data_of, identify
    from probedesign.identification.result import Identification
    from probedesign.prediction.fused import PressSchedule
    from probedesign.prediction.predict import Prediction, predict, predict_touch
    from probedesign.probe import Probe, build_probe
    from probedesign.rod.batch import solve_batch
    from probedesign.rod.contact import press_poses, solve_frictionless
    from probedesign.rod.equilibrium import Equilibrium
    from probedesign.rod.friction import CoulombSolver, press_against_line, press_against_point
    from probedesign.rod.rod import Rod
    from probedesign.validation.validate import ValidationReport, validate

#: Names of each module.
_MODULES = {
    "campaigns": ("Campaign", "read_campaign"),
    "core.errors": ("InputError",),
    "design": ("Design", "check_design", "load_design", "new", "parse_design"),
    "design.catalog": ("Resin",),
    "design.sensors": ("Noise", "SensorModel"),
    "estimation.detector": ("Detector",),
    "estimation.estimator": ("Estimator",),
    "estimation.estimate": ("Estimate", "FusedEstimate"),
    "estimation.model": ("Tolerances",),
    "estimation.tracker": ("Tracker",),
    "frozen_probe": ("load_estimator",),
    "geometry": ("CrossSection",),
    "identification.identify": ("data_of", "identify"),
    "identification.result": ("Identification",),
    "prediction.fused": ("PressSchedule",),
    "prediction.predict": ("Prediction", "predict", "predict_touch"),
    "probe": ("Probe", "build_probe"),
    "rod.batch": ("solve_batch",),
    "rod.contact": ("press_poses", "solve_frictionless"),
    "rod.equilibrium": ("Equilibrium",),
    "rod.friction": ("CoulombSolver", "press_against_line", "press_against_point"),
    "rod.rod": ("Rod",),
    "validation.validate": ("ValidationReport", "validate"),
}
_RENAMED = {"SensorModel": "Sensor"}
#: Module and attribute of each public name; `Priors` is a second name of `Tolerances`, the priors of an estimator.
_LOCATIONS = {
    _RENAMED.get(name, name): (f"probedesign.{module}", name) for module, names in _MODULES.items() for name in names
} | {"Priors": ("probedesign.estimation.model", "Tolerances")}
__all__ = [
    "Campaign", "CoulombSolver", "CrossSection", "Design", "Detector", "Equilibrium", "Estimate", "Estimator",
    "FusedEstimate", "Identification", "InputError", "Noise", "Prediction", "PressSchedule", "Priors", "Probe",
    "Resin", "Rod", "Sensor", "Tolerances", "Tracker", "ValidationReport", "build_probe", "check_design", "data_of",
    "identify", "load_design", "load_estimator", "new", "parse_design", "predict", "predict_touch",
    "press_against_line", "press_against_point", "press_poses", "read_campaign", "solve_batch", "solve_frictionless",
    "validate",
]  # fmt: skip


def _views() -> "Any":
    from probedesign.reports import notebook

    return notebook


_set_views(_views)


def __getattr__(name: str) -> "Any":
    """Import a public name when it is first used, and keep it."""
    if name not in _LOCATIONS:
        raise AttributeError(f"module 'probedesign' has no attribute '{name}'")
    module, attribute = _LOCATIONS[name]
    from importlib import import_module

    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    """Return the public names with those of the module itself."""
    return sorted({*globals(), *__all__})
