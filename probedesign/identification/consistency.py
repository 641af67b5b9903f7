"""When so many readings lie far off that it is the campaign, or the design, that is wrong.

A fit that hardly counts gross errors may leave out a whole kind of reading and find the rest in order; E then rests on
what is left, with an interval that knows nothing of it. So the outliers themselves are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binom

from probedesign.identification.residuals import Group
from probedesign.identification.robust import DOUBTED, ROBUST, Noise

GROSS = 0.05
"""Share of gross errors that is taken as usual. Source: F. Hampel et al., Robust Statistics, 1986: 1 to 10 % in routine
data. Far below one half, where the median breaks, by which the search sets out."""
STRANGE = 3.0
"""Readings that scatter so many times their stated noise are no noise: the tests contradict the model."""
_LOOK = {
    "markers": "the unit of their columns, s_mm, side_deg and the base's rotation in campaign.toml, and how they are "
    "numbered",
    "wrenches": "the units of the force and of the moment columns, their frame, and the base's rotation in "
    "campaign.toml",
    "touches": "the unit of the contact columns, the base's rotation in campaign.toml and, where markers are told, "
    "their s_mm and side_deg",
}
_NAMES = {"markers": "markers", "wrenches": "wrenches", "touches": "places touched"}


@dataclass(frozen=True)
class Share:
    """How many of some readings hardly count.

    Attributes:
        count: of all of them.
        off: of those that noise does not explain.
        farthest: of these, in standard deviations.
    """

    count: int
    off: int
    farthest: float

    @property
    def most(self) -> bool:
        """More than half: the median, too, is told by outliers."""
        return 2 * self.off > self.count

    @property
    def too_many(self) -> bool:
        """More than gross errors make with a chance of one in a thousand, or most."""
        return self.most or float(binom.sf(self.off - 1, self.count, GROSS)) < DOUBTED

    @property
    def words(self) -> str:
        """For messages."""
        return f"{self.off} of {self.count} hardly count, the farthest {self.farthest:.3g} standard deviations off"


def contradiction(groups: Sequence[Group], off: Sequence[tuple[Group, float]], noise: Sequence[Noise]) -> str:
    """Why the tests contradict the design, or each other; empty if they do not.

    Args:
        groups: of the whole campaign.
        off: the outliers, from `robust.outliers`.
        noise: of each kind.
    """
    kinds = {kind: share for kind in ROBUST if (share := _share(groups, off, kind=kind)).too_many}
    bad = _bad_tests(groups, off)
    if kinds:
        kind, share = max(kinds.items(), key=lambda pair: (pair[1].off / pair[1].count, pair[1].farthest))
        mostly = f", most of all in {_listed(bad)}" if bad else ""
        return f"{_NAMES[kind]}: {share.words}; look at {_LOOK[kind]}{mostly}"
    if bad:
        share = _share(groups, off, test=bad[0])
        return (f"readings of {_listed(bad)}: {share.words}; look at its known force and s_contact_mm, how its "
                "markers are numbered, its wrench and its base, or leave the test out")  # fmt: skip
    every = _share(groups, off)
    if every.too_many:
        return f"readings of all kinds: {every.words}; look at units and the base's rotation in campaign.toml"
    wild = max((one for one in noise if one.scale > STRANGE), key=lambda one: one.scale, default=None)
    if wild is None:
        return ""
    return (f"{_NAMES[wild.kind]} scatter {wild.scale:.2g} times as much as stated, so the probe as designed does not "
            f"explain them; look at {_LOOK[wild.kind]}")  # fmt: skip


def hardly_counted(groups: Sequence[Group], off: Sequence[tuple[Group, float]]) -> list[str]:
    """A line for each kind of which more than the usual gross errors hardly count."""
    shares = {kind: _share(groups, off, kind=kind) for kind in ROBUST}
    return [
        f"{_NAMES[kind]}: {share.words}" for kind, share in shares.items() if share.off > GROSS * share.count
    ]


def _bad_tests(groups: Sequence[Group], off: Sequence[tuple[Group, float]]) -> list[str]:
    """Tests of whose readings most hardly count, and of which that is more than one."""
    tests = dict.fromkeys(group.test for group, _ in off)
    shares = {test: _share(groups, off, test=test) for test in tests}
    return [test for test, share in shares.items() if share.off > 1 and share.most]


def _share(
    groups: Sequence[Group],
    off: Sequence[tuple[Group, float]],
    kind: str | None = None,
    test: str | None = None,
) -> Share:
    def counts(group: Group) -> bool:
        return group.kind in ROBUST and kind in (None, group.kind) and test in (None, group.test)

    far = [distance for group, distance in off if counts(group)]
    return Share(sum(map(counts, groups)), len(far), max(far, default=0.0))


def _listed(tests: Sequence[str]) -> str:
    return ", ".join(tests[:3]) + (f" and {len(tests) - 3} more" if len(tests) > 3 else "")
