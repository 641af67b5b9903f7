"""The public names of the package: where they are, that they are imported lazily, and what each part loads."""

import ast
import inspect
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import probedesign
from probedesign.rod.contact import solve_surface_force

NOUNS = {"Campaign", "Design", "Detector", "Estimate", "Estimator", "FusedEstimate", "Identification", "Prediction",
         "Priors", "Probe", "Rod", "Sensor", "Tolerances", "Tracker"}  # fmt: skip
VERBS = {"build_probe", "identify", "load_design", "load_estimator", "predict", "read_campaign", "validate"}


def modules_after(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules, sep='\\n')"],
        capture_output=True, text=True, timeout=300, check=True,
    )  # fmt: skip
    return set(done.stdout.split())


def own(modules: set[str]) -> set[str]:
    return {name for name in modules if name.split(".")[0] == "probedesign"}


def test_the_nouns_and_verbs_are_public():
    assert set(probedesign.__all__) >= NOUNS | VERBS
    assert set(probedesign.__all__) <= set(dir(probedesign))


@pytest.mark.parametrize("name", probedesign.__all__)
def test_each_public_name_has_a_docstring_and_a_signature_without_any_options(name):
    thing = getattr(probedesign, name)
    assert inspect.getdoc(thing)
    if not inspect.isclass(thing):
        assert not any(p.kind is p.VAR_KEYWORD for p in inspect.signature(thing).parameters.values())


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(probedesign.__file__).read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    own = [node for node in block.body if node.module.startswith("probedesign")]
    seen = {a.asname or a.name: (node.module, a.name) for node in own for a in node.names}
    assert seen == probedesign._LOCATIONS
    assert list(seen) != [] and set(seen) == set(probedesign.__all__)
    assert (Path(probedesign.__file__).parent / "py.typed").is_file()


def test_priors_is_a_second_name_of_tolerances():
    assert probedesign.Priors is probedesign.Tolerances


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Porbe'"):
        _ = probedesign.Porbe


def test_importing_the_package_loads_only_the_methods_that_notebooks_call():
    loaded = modules_after("import probedesign")
    assert own(loaded) == {"probedesign", "probedesign.core", "probedesign.core.notebook"}
    assert not {"typing", "numpy", "scipy", "numba", "pydantic"} & loaded


def test_no_public_name_loads_cad():
    loaded = modules_after("import probedesign\nfor name in probedesign.__all__: getattr(probedesign, name)")
    assert len(own(loaded)) > len(probedesign.__all__)
    assert not {"cadquery", "OCP", "trimesh", "lib3mf", "matplotlib"} & {name.split(".")[0] for name in loaded}


def test_an_export_loads_no_mechanics_and_few_modules():
    if find_spec("cadquery") is None:
        pytest.skip("no CadQuery")
    count = "import sys; print('COUNT', sum(name.split('.')[0] == 'probedesign' for name in sys.modules))"
    code = f"import probedesign.cli.main, probedesign.cli.export, probedesign.cad.mesh; {count}"
    loaded = modules_after(f"{code}\nimport probedesign.cad.export")
    packages = {name.split(".")[1] for name in own(loaded) if "." in name}
    assert not {"rod", "estimation", "prediction", "frozen_probe", "live"} & packages
    assert len(own(loaded)) <= 56
    (of_one_part,) = (int(name) for name in loaded if name.isdigit())
    assert of_one_part <= 44


def test_a_studio_loads_nothing_of_live_and_at_most_84_modules():
    pytest.importorskip("viser")
    loaded = own(modules_after("import probedesign.cli.studio, probedesign.studio.page"))
    assert not {"live", "optimization", "identification", "cad"} & {
        name.split(".")[1] for name in loaded if "." in name
    }
    assert len(loaded) <= 84


def test_an_estimator_loads_no_design_and_no_drawing():
    loaded = own(modules_after("import probedesign; probedesign.load_estimator"))
    assert not {"probedesign.design.schema", "probedesign.probe", "probedesign.cad"} & loaded
    assert len(loaded) <= 60


def test_one_estimate_runs_python_code_of_at_most_12_modules():
    """An estimate of a stream is one call of the kernels with little around it; compiled code does not count."""
    probe = probedesign.build_probe(probedesign.load_design(Path(__file__).parents[1] / "designs" / "large.toml"))
    estimator, gravity = probe.estimator(), probe.design.mount.gravity_base_m_s2
    touched = solve_surface_force(probe.rod, gravity, 0.6 * probe.length, 0.3, 0.03, (0.2, -0.1))
    wrench = touched.equilibrium.wrench_base
    assert estimator.estimate(wrench).ok  # compiles, and caches what belongs to the gravity
    package, ran = Path(probedesign.__file__).parent, set()

    def note(frame, event, _argument):
        if event == "call" and package in Path(frame.f_code.co_filename).parents:
            ran.add(Path(frame.f_code.co_filename).relative_to(package).as_posix())

    sys.setprofile(note)
    try:
        found = estimator.estimate(wrench)
    finally:
        sys.setprofile(None)
    assert found.ok and "estimation/estimator.py" in ran
    assert len(ran) <= 12, sorted(ran)
