"""Design, print and run soft conic probes that locate a touch from the wrench at their base.

The usual way through the package::

    design = probedesign.load_design("designs/large.toml")        # Design
    probe = probedesign.build_probe(design)                       # Probe: geometry, sections, mass
    equilibrium = probe.solve(force_base=(0.01, 0.0, 0.0))        # Equilibrium of its Rod
    prediction = probe.predict()                                  # Prediction: expected contact error
    estimator = probe.estimator()                                 # Estimator, or load_estimator(path)
    estimate = estimator.estimate(equilibrium.wrench_base)        # Estimate: contact and covariance

`read_campaign` reads the measurements of a print, `identify` estimates its parameters from them, and `validate`
compares an estimator with a reference. Lengths are in metres, forces in newtons, moments in newton metres; a name ends
in its unit where that is another. Each name is imported when it is first used, so that `import probedesign` stays fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probedesign.campaigns import Campaign as Campaign
    from probedesign.campaigns import read_campaign as read_campaign
    from probedesign.core.errors import InputError as InputError
    from probedesign.design import Design as Design
    from probedesign.design import check_design as check_design
    from probedesign.design import load_design as load_design
    from probedesign.design import parse_design as parse_design
    from probedesign.design.catalog import Resin as Resin
    from probedesign.design.sensors import Noise as Noise
    from probedesign.design.sensors import SensorModel as Sensor
    from probedesign.estimation.detector import Detector as Detector
    from probedesign.estimation.estimate import Estimate as Estimate
    from probedesign.estimation.estimator import Estimator as Estimator
    from probedesign.estimation.fused import FusedEstimate as FusedEstimate
    from probedesign.estimation.tolerances import Tolerances as Tolerances
    from probedesign.estimation.tracker import Tracker as Tracker
    from probedesign.estimation.unknowns import Unknowns as Priors
    from probedesign.frozen_probe import load_estimator as load_estimator
    from probedesign.geometry import CrossSection as CrossSection
    from probedesign.identification.identify import data_of as data_of
    from probedesign.identification.identify import identify as identify
    from probedesign.identification.result import Identification as Identification
    from probedesign.prediction.fused import PressSchedule as PressSchedule
    from probedesign.prediction.predict import Prediction as Prediction
    from probedesign.prediction.predict import predict as predict
    from probedesign.prediction.predict import predict_touch as predict_touch
    from probedesign.probe import Probe as Probe
    from probedesign.probe import build_probe as build_probe
    from probedesign.rod.batch import solve_batch as solve_batch
    from probedesign.rod.contact import solve_frictionless as solve_frictionless
    from probedesign.rod.equilibrium import Equilibrium as Equilibrium
    from probedesign.rod.rod import Rod as Rod
    from probedesign.validation.validate import ValidationReport as ValidationReport
    from probedesign.validation.validate import validate as validate

_LOCATIONS = {
    "Campaign": "probedesign.campaigns:Campaign",
    "CrossSection": "probedesign.geometry:CrossSection",
    "Design": "probedesign.design:Design",
    "Detector": "probedesign.estimation.detector:Detector",
    "Equilibrium": "probedesign.rod.equilibrium:Equilibrium",
    "Estimate": "probedesign.estimation.estimate:Estimate",
    "Estimator": "probedesign.estimation.estimator:Estimator",
    "FusedEstimate": "probedesign.estimation.fused:FusedEstimate",
    "Identification": "probedesign.identification.result:Identification",
    "InputError": "probedesign.core.errors:InputError",
    "Noise": "probedesign.design.sensors:Noise",
    "Prediction": "probedesign.prediction.predict:Prediction",
    "PressSchedule": "probedesign.prediction.fused:PressSchedule",
    "Priors": "probedesign.estimation.unknowns:Unknowns",
    "Probe": "probedesign.probe:Probe",
    "Resin": "probedesign.design.catalog:Resin",
    "Rod": "probedesign.rod.rod:Rod",
    "Sensor": "probedesign.design.sensors:SensorModel",
    "Tolerances": "probedesign.estimation.tolerances:Tolerances",
    "Tracker": "probedesign.estimation.tracker:Tracker",
    "ValidationReport": "probedesign.validation.validate:ValidationReport",
    "build_probe": "probedesign.probe:build_probe",
    "check_design": "probedesign.design:check_design",
    "data_of": "probedesign.identification.identify:data_of",
    "identify": "probedesign.identification.identify:identify",
    "load_design": "probedesign.design:load_design",
    "load_estimator": "probedesign.frozen_probe:load_estimator",
    "parse_design": "probedesign.design:parse_design",
    "predict": "probedesign.prediction.predict:predict",
    "predict_touch": "probedesign.prediction.predict:predict_touch",
    "read_campaign": "probedesign.campaigns:read_campaign",
    "solve_batch": "probedesign.rod.batch:solve_batch",
    "solve_frictionless": "probedesign.rod.contact:solve_frictionless",
    "validate": "probedesign.validation.validate:validate",
}
"""Module and attribute of each public name."""
__all__ = [
    "Campaign",
    "CrossSection",
    "Design",
    "Detector",
    "Equilibrium",
    "Estimate",
    "Estimator",
    "FusedEstimate",
    "Identification",
    "InputError",
    "Noise",
    "Prediction",
    "PressSchedule",
    "Priors",
    "Probe",
    "Resin",
    "Rod",
    "Sensor",
    "Tolerances",
    "Tracker",
    "ValidationReport",
    "build_probe",
    "check_design",
    "data_of",
    "identify",
    "load_design",
    "load_estimator",
    "parse_design",
    "predict",
    "predict_touch",
    "read_campaign",
    "solve_batch",
    "solve_frictionless",
    "validate",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, and keep it."""
    if name not in _LOCATIONS:
        raise AttributeError(f"module 'probedesign' has no attribute '{name}'")
    module, _, attribute = _LOCATIONS[name].partition(":")
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    """Return the public names with those of the module itself."""
    return sorted({*globals(), *__all__})
