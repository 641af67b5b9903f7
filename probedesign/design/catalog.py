"""Resins, printers, screws, robot flanges and the probes of the paper by name: the facts to which a design refers.

Every number has its source. A new resin, printer or flange is one record here; the other packages read it.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

from probedesign.core.errors import unknown_name
from probedesign.core.units import MM, MPA

Provenance = Literal["assumed", "datasheet", "identified"]
Record = TypeVar("Record")


def find(records: Mapping[str, Record], name: str, key: str, *others: str) -> Record:
    """Return the record of that name.

    Args:
        records: by name.
        name: in the design file.
        key: of the design file.
        others: names that the key may have besides, for the message.

    Raises:
        InputError: there is no such record; the message lists the known ones.
    """
    try:
        return records[name]
    except KeyError:
        raise unknown_name(key, name, [*records, *others]) from None


@dataclass(frozen=True)
class Quantity:
    """A number in SI units with its provenance and source."""

    value: float
    provenance: Provenance
    source: str


@dataclass(frozen=True)
class PostProcessing:
    """What to do with a print after the printer, a line for each step, in order."""

    wash: str = "as the resin's data sheet says, in clean solvent; flush holes and engraving"
    dry: str = (
        "in air until two weighings an hour apart agree, before it is cured, and again before calipers: solvent in the "
        "resin swells it (assumed)"
    )
    cure: str = "as the resin's data sheet says"
    ageing: str = "not published: measure its diameters and identify E after the last cure, and again after a month"
    storage: str = "hanging, dark, dry and at the temperature at which it is used: light cures it further (assumed)"


@dataclass(frozen=True)
class Resin:
    """A printable material."""

    name: str  #: as written in a design file.
    product: str  #: name of the product, in messages and sources.
    youngs_modulus: Quantity  #: E at small strain [Pa].
    shear_modulus: Quantity  #: G [Pa]; independent of E on purpose (docs/decisions/0004).
    stiffness_spread: Quantity  #: standard deviation of E, and of G, of a print that was not identified, relative [-].
    density: Quantity  #: cured [kg/m³].
    #: tangential over normal force of a touch [-], standard deviation of the prior per tangential direction.
    friction: Quantity
    density_tolerance_source: str  #: source of the relative standard deviation of the density, `Tolerances.density`.
    post: PostProcessing = PostProcessing()


#: Friction of an elastic resin that has not been measured [-]. No value is published for Elastic 50A.
ELASTIC_FRICTION = Quantity(
    0.6, "assumed", "soft polyurethane on card, plastic or metal: about 0.5 to 1; assumed until measured"
)

#: Compliance of an object that is not known, scale of a half-normal prior [m/N].
OBJECT_COMPLIANCE = Quantity(0.05, "assumed", "delicate objects, as a card house, yield by 5 to 50 N/m")

#: E, and G, of a print that was not identified [-].
STIFFNESS_SPREAD = Quantity(0.1, "assumed", "published values of E of one resin differ by 20 %: half of it")
#: The same where no measurement of this very resin is known [-].
UNMEASURED_SPREAD = Quantity(0.2, "assumed", "no measurement of this resin is known; those of one resin differ by 20 %")

_PAPER = "paper, section IV: identified on the paper's prints of Elastic 50A V1, not on yours"

ELASTIC_50A = Resin(
    name="elastic-50a",
    product="Elastic 50A V1",
    youngs_modulus=Quantity(2.32 * MPA, "assumed", _PAPER),
    shear_modulus=Quantity(0.761 * MPA, "assumed", _PAPER),
    stiffness_spread=STIFFNESS_SPREAD,
    density=Quantity(1010.0, "datasheet", "Formlabs Elastic 50A V1, 1.00-1.02 g/ml"),
    friction=ELASTIC_FRICTION,
    density_tolerance_source="datasheet: Formlabs Elastic 50A V1, 1.00-1.02 g/ml, its half width taken for one "
    "standard deviation",
    post=PostProcessing(wash="20 min in isopropanol (Formlabs)", cure="20 min at 60 °C (Formlabs)"),
)
#: What is sold as Elastic 50A today. Its stiffness and density have not been found published.
ELASTIC_50A_V2 = replace(
    ELASTIC_50A,
    name="elastic-50a-v2",
    product="Elastic 50A V2",
    youngs_modulus=Quantity(2.32 * MPA, "assumed", "as Elastic 50A V1: identify before you rely on it"),
    shear_modulus=Quantity(0.761 * MPA, "assumed", "as Elastic 50A V1: identify before you rely on it"),
    stiffness_spread=UNMEASURED_SPREAD,
    density=Quantity(1010.0, "assumed", "as Elastic 50A V1: weigh the print"),
    density_tolerance_source="assumed: 1 %, as of Elastic 50A V1; no density of Elastic 50A V2 is known",
    post=PostProcessing(cure="20 min at 60 °C (Formlabs)"),
)


def _incompressible(
    name: str, product: str, E_mpa: float, density: float, E_source: str, spread: Quantity, density_source: str
) -> Resin:
    """Return a soft resin of which E alone is known: G = E/3, the incompressible limit, marked as assumed."""
    return Resin(
        name=name,
        product=product,
        youngs_modulus=Quantity(E_mpa * MPA, "assumed", E_source),
        shear_modulus=Quantity(E_mpa * MPA / 3.0, "assumed", "E/3, the incompressible limit"),
        stiffness_spread=spread,
        density=Quantity(density, "datasheet", density_source),
        friction=ELASTIC_FRICTION,
        density_tolerance_source=f"assumed: 1 %, as of Elastic 50A V1; the data sheet of {product} has no range",
    )


FLEXIBLE_80A = _incompressible(
    "flexible-80a", "Flexible 80A", 6.3, 1120.0,
    "stress at 100 % strain (V1) taken for E: identify before you rely on it",
    UNMEASURED_SPREAD,
    "Formlabs Flexible 80A V2, 1.12 g/ml",
)  # fmt: skip
SILICONE_40A = replace(_incompressible(
    "silicone-40a", "Silicone 40A", 0.95, 1040.0,
    "36 prints by others, washed in two ways: 0.93 and 1.01 MPa, from a Phrozen Sonic Mini 8K, soaked in saline "
    "(Scientific Data 2025, doi 10.1038/s41597-025-05738-7): identify yours",
    Quantity(0.1, "assumed", "5 and 13 % within the two groups of the prints that E is from"),
    "Formlabs Silicone 40A, 1.04 g/ml",
), post=PostProcessing(
    wash="as its data sheet says; of 72 prints by others washing changed the thickness by 7 to 20 %, and E by 9 % with "
    "the solvent (doi 10.1038/s41597-025-05738-7)"
))  # fmt: skip

RESINS = {resin.name: resin for resin in (ELASTIC_50A, ELASTIC_50A_V2, FLEXIBLE_80A, SILICONE_40A)}

#: Material of the adapters; any resin that is stiff against the probe is suitable.
RIGID_RESIN = "rigid resin, e.g. Grey V4"
#: Density of the rigid adapters [kg/m³]. Source: Formlabs Grey/Clear V4, 1.15-1.2 g/ml; the middle, assumed.
RIGID_DENSITY = 1180.0


GUIDE = "Formlabs' design guide, Form 2, rigid resin"


@dataclass(frozen=True)
class PrintLimits:
    """Layer of a printer and the smallest features that it prints in a rigid resin; keys as in a printer file."""

    layer_mm: float = 0.1  #: Elastic 50A has no other on printers of Formlabs. Source: PreForm's list of materials.
    supported_wall_mm: float = 0.4  #: held on two or more sides.
    wall_mm: float = 0.6  #: held on one side.
    hole_mm: float = 0.5
    drain_mm: float = 3.5  #: hole through which resin drains.
    engraving_mm: float = 0.4  #: width and depth of a stroke (assumed).
    soft_feature_mm: float = 1.5  #: unsupported feature of soft resin (assumed).
    overhang_deg: float = 19.0  #: of an unsupported surface above the horizontal.
    source: str = GUIDE


@dataclass(frozen=True)
class Printer:
    """A printer: its name in a design file, its build volume along x, y, z [mm], and its limits."""

    name: str
    product: str
    build_volume_mm: tuple[float, float, float]
    limits: PrintLimits = PrintLimits()


#: Source: PreForm.
PRINTERS = {
    printer.name: printer
    for printer in (
        Printer("form-2", "Form 2", (145.0, 145.0, 175.0)),
        Printer("form-3", "Form 3", (145.0, 145.0, 185.0)),
        Printer("form-3l", "Form 3L", (336.0, 200.0, 300.0)),
        Printer("form-4", "Form 4", (200.0, 125.0, 210.0)),
        Printer("form-4l", "Form 4L", (353.0, 196.0, 350.0)),
    )
}


@dataclass(frozen=True)
class SocketScrew:
    """A socket head cap screw, ISO 4762; its shank is modelled as a cylinder of the thread's pitch diameter."""

    thread: str  #: its designation, such as "M2".
    head_d: float  #: head_d, head_height: of the head [m].
    head_height: float
    socket_af: float  #: socket_af, socket_depth: hexagon across flats and its depth [m].
    socket_depth: float
    pitch_d: float  #: pitch diameter of the thread [m].
    clearance_d: float  #: of a through hole [m].
    key_length: float  #: long arm of its hexagon key, standard series [m].
    stock_mm: tuple[int, ...]  #: lengths in stock [mm].

    @property
    def nominal_d(self) -> float:
        """Return the nominal diameter of the thread [m]."""
        return float(self.thread[1:]) * MM

    @property
    def counterbore_d(self) -> float:
        """Return the diameter of the room for the head in printed resin [m]."""
        return self.head_d + 0.4 * MM

    def length_tolerance(self, length: float) -> float:
        """Return the tolerance ± [m] of a length under the head [m]: js15.

        Source: ISO 4759-1 with ISO 286-2; an M2x6 measures 5.76 to 6.24 mm.
        """
        return next(t for up_to, t in _JS15_MM if length / MM <= up_to + 1e-6) * MM


#: Largest length and its tolerance.
_JS15_MM = ((3.0, 0.20), (6.0, 0.24), (10.0, 0.29), (18.0, 0.35), (30.0, 0.42), (50.0, 0.50))


@dataclass(frozen=True)
class Nut:
    """A hexagon nut, ISO 4032: width across flats and height [m]."""

    af: float
    height: float


def _screw(thread: str, lengths_mm: tuple[float, ...], stock_mm: tuple[int, ...]) -> SocketScrew:
    head_d, head, socket_af, socket, pitch_d, hole_d, key = (length * MM for length in lengths_mm)
    return SocketScrew(thread, head_d, head, socket_af, socket, pitch_d, hole_d, key, stock_mm)


#: Source: ISO 4762 (heads, sockets, lengths), ISO 724 (pitch diameters), ISO 273, medium (holes), ISO 2936 (keys).
SCREWS = {
    screw.thread: screw
    for screw in (
        _screw("M2", (3.8, 2.0, 1.5, 1.0, 1.740, 2.4, 46.5), (3, 4, 5, 6, 8, 10, 12)),
        _screw("M3", (5.5, 3.0, 2.5, 1.3, 2.675, 3.4, 57.5), (5, 6, 8, 10, 12, 16, 20)),
        _screw("M4", (7.0, 4.0, 3.0, 2.0, 3.545, 4.5, 66.0), (8, 10, 12, 16, 20, 25)),
        _screw("M5", (8.5, 5.0, 4.0, 2.5, 4.480, 5.5, 74.0), (8, 10, 12, 16, 20, 25)),
        _screw("M6", (10.0, 6.0, 5.0, 3.0, 5.350, 6.6, 85.0), (10, 12, 16, 20, 25, 30)),
        _screw("M8", (13.0, 8.0, 6.0, 4.0, 7.188, 9.0, 96.0), (12, 16, 20, 25, 30, 35)),
    )
}
M2 = SCREWS["M2"]
NUTS = {"M2": Nut(4.0 * MM, 1.6 * MM), "M3": Nut(5.5 * MM, 2.4 * MM)}
#: Tolerance ± of a printed length, or 0.5 % where that is more: none is published (assumed).
PRINT_TOLERANCE = 0.15 * MM
MIN_GRIP = 3.0 * MM  #: Least resin under the head of a screw into a sensor [m] (assumed).
STEEL_DENSITY = 7900.0  #: Of screws, nuts and pins [kg/m³]. Source: stainless A2, any table; assumed.


@dataclass(frozen=True)
class RobotFlange:
    """A pattern to which the flange adapter is bolted. Azimuths are measured from the dowel hole; lengths in metres."""

    name: str  #: as written in a design file.
    bolt_circle_d: float  #: of the tapped holes and of the dowel.
    bolt_azimuths_deg: tuple[float, ...]  #: of the tapped holes, from the dowel.
    bolt: str  #: thread name.
    max_bolt_entry: float  #: largest depth to which a screw may enter the robot.
    bolt_length: float  #: length of the stock screw for which the adapter is dimensioned.
    pin_slot: tuple[float, float]  #: width and radial length of the slot for the dowel pin; zeros for none.
    spigot: tuple[float, float]  #: diameter and height of the centring boss; zeros for none.
    face_d: float  #: diameter of the flange's face.
    source: str  #: of the numbers.
    spigot_play: float = 0.2 * MM  #: of the boss in the robot's recess, on the diameter.

    @property
    def screw(self) -> SocketScrew:
        """Return the dimensions of its bolts."""
        return SCREWS[self.bolt]

    @property
    def pin_d(self) -> float:
        """Return the diameter of the dowel pin that fits the slot with 0.2 mm of play [m]; 0 without a slot."""
        return max(self.pin_slot[0] - 0.2 * MM, 0.0)


def _iso_9409(
    holes: str, slot_mm: tuple[float, float], spigot_mm: tuple[float, float], face_mm: float, entry_mm: float = 6.0
) -> RobotFlange:
    """Return a pattern of ISO 9409-1 such as "50-4-M6". Of six holes every second takes a bolt, for the cable."""
    circle, count, bolt = holes.split("-")
    azimuths = (45.0, 135.0, 225.0, 315.0) if count == "4" else (30.0, 150.0, 270.0)
    slot, spigot = ((pair[0] * MM, pair[1] * MM) for pair in (slot_mm, spigot_mm))
    return RobotFlange(
        f"iso-9409-1-{holes.lower()}", float(circle) * MM, azimuths, bolt, entry_mm * MM,
        (12.0 if bolt != "M8" else 16.0) * MM, slot, spigot, face_mm * MM, f"ISO 9409-1-{holes}",
    )  # fmt: skip


_UNCHECKED = "azimuths of the holes, pin and depth of the threads assumed: compare them with your robot"

ROBOT_FLANGES = {
    flange.name: flange
    for flange in (
        replace(_iso_9409("50-4-M6", (6.2, 9.0), (31.3, 4.0), 63.0), source="ISO 9409-1-50-4-M6 (UR, Franka)"),
        # Assumed: the thread depth of M5, which is not in our sources; the slot, by analogy with the 50 mm pattern.
        # The spigot is the Ø20 H7 recess less 0.2 mm, as for the 50 mm pattern.
        _iso_9409("31.5-4-M5", (5.2, 8.0), (19.8, 4.0), 40.0),
        # Circle, recess and face: https://graspmonkey.de/en/blogs/news/iso-9409-1-die-schnittstelle-zwischen-roboter-
        # und-werkzeug. That of 100 mm continues its series (assumed). The spigots end 0.5 mm above the recess's bottom.
        *(
            replace(flange, source=f"{flange.source}; {_UNCHECKED}", spigot_play=play * MM)
            for play, flange in (
                (0.2, _iso_9409("63-6-M6", (6.2, 9.0), (39.8, 3.5), 80.0)),
                (0.3, _iso_9409("80-6-M8", (8.2, 11.0), (49.7, 4.5), 100.0, 8.0)),
                (0.4, _iso_9409("100-6-M8", (8.2, 11.0), (62.6, 4.5), 125.0, 8.0)),
            )
        ),
    )
}

CUSTOM = "own"  #: Value of `mount.robot_flange` where the pattern is in the design file itself, in `[mount.flange]`.

#: Keys of a design whose values may be assumed, in words, each with what measures it.
_ASSUMED = {
    "material.youngs_modulus_mpa": "E (identify)",
    "material.shear_modulus_mpa": "G (identify)",
    "material.density_kg_m3": "density (balance)",
    "mount.root_rigid_radii": "bending of the root (identify)",
    "contact.friction": "friction (tilted plate)",
    "contact.object_compliance_m_N": "compliance of the object (two presses at different places of the probe)",
    "sensor.model": "model of the sensor (its label)",
    "sensor.calibration": "calibration of the sensor (its label)",
}


def assumed_text(keys: Iterable[str]) -> str:
    """Return assumed keys of a design, such as `Design.assumptions`, in words with what measures each."""
    words = (_ASSUMED.get(key, re.sub(r"^probe\.(.*)_mm$", r"\1 (calipers)", key)) for key in keys)
    return ", ".join(words) or "nothing"


# The probes of the paper as presets, and the conditions of its Table I. Source: "Spatial Position Estimation of
# Lightweight and Delicate Objects using a Soft haptic Probe", section IV and Table I.

#: Length, base and tip diameter [mm]. The lengths are from Table I; all diameters except the large probe's base are
#: assumed: the paper shows them in a figure without numbers.
PROBES = {"large": (150.0, 12.0, 2.0), "medium": (100.0, 8.0, 2.0), "small": (50.0, 5.0, 1.5)}
#: Touches of Table I by probe: fraction of the length and force [N]. The directions of the pushes are not given.
CONDITIONS = {
    "large": ((0.133, 0.25), (0.266, 0.22), (0.266, 0.053), (0.4, 0.103), (0.4, 0.052), (0.533, 0.014), (0.533, 0.032),
              (0.666, 0.011), (0.8, 0.006)),
    "medium": ((0.1, 1.5), (0.3, 0.23), (0.5, 0.126), (0.5, 0.055), (0.7, 0.26), (0.8, 0.02), (0.9, 0.005)),
    "small": ((0.2, 0.4), (0.4, 0.11), (0.4, 0.2), (0.6, 0.07), (0.6, 0.047), (0.6, 0.083), (0.8, 0.032)),
}  # fmt: skip
_MATERIAL = {"youngs_modulus_mpa": 2.32, "shear_modulus_mpa": 0.761, "density_kg_m3": 1010.0}
_PROVENANCE = dict(zip(_MATERIAL, ("identified", "identified", "datasheet"), strict=True))


def paper_tables(name: str) -> dict[str, Any]:
    """Return the tables of one of the paper's probes, as in designs/large.toml, medium.toml and small.toml.

    Args:
        name: a key of `PROBES`.
    """
    length, base, tip = PROBES[name]
    probe = {"shape": "cone", "length_mm": length, "base_d_mm": base, "tip_d_mm": tip,
             "assumed": ["tip_d_mm"] if name == "large" else ["base_d_mm", "tip_d_mm"]}  # fmt: skip
    material = {"resin": "elastic-50a", **_MATERIAL, "provenance": _PROVENANCE}
    sensor = {"model": "nano17", "calibration": "si-12-0.12"}
    return {"schema": 1, "name": name, "probe": probe, "material": material, "sensor": sensor,
            "mount": {"hold": "bonded", "root_rigid_radii": 0.12},
            "contact": {"friction": ELASTIC_50A.friction.value}}  # fmt: skip
