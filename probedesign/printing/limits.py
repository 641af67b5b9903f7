"""The rules of printing and their numbers. Lengths [mm], angles from the horizontal [deg].

What Formlabs publishes was found on a Form 2 with rigid resin. For soft resin nothing is published: twice the
figure of the rigid one is taken for good, the figure itself for the least.
"""

from probedesign.printing.rule import Rule

GUIDE = "Formlabs' design guide, Form 2, rigid resin"
DOUBLED = f"twice {GUIDE}, for soft resin (assumed)"

LAYER = 0.1
"""Elastic 50A prints in no other. Source: PreForm's list of materials."""

RAFT_THICKNESS = 2.0
HEIGHT_ABOVE_RAFT = 5.0
RAFT_MARGIN = 5.0
"""What stands below the base and around it (assumed); `print` asks PreForm for the first two."""
STANDING = (
    f"raft {RAFT_THICKNESS:g} mm, supports {HEIGHT_ABOVE_RAFT:g} mm, margin {RAFT_MARGIN:g} mm (assumed)"
)

HELD_WALL, FREE_WALL, HOLE = 0.4, 0.6, 0.5
"""Of rigid resin: a wall held on two sides or more, a wall held on one, a hole that stays open."""
SOFT = 2.0
"""Factor on the three for soft resin (assumed)."""
TIP = 1.5
"""Least thickness of soft resin that stands by itself (assumed)."""
SLENDER, TOO_SLENDER = 0.05, 0.025
"""Diameter over the height that stands on it: vertical wires print from Ø0.3 (7 mm tall) to Ø1.5 (30 mm tall)."""
OVERHANG, SOFT_OVERHANG = 19.0, 45.0
DRAIN = 3.5

BUILD_VOLUME = Rule("build_volume", "mm", f"PreForm's build volumes; {STANDING}", "high")
SLENDERNESS = Rule(
    "slenderness", "1", f"about the wires of {GUIDE}; an error below half of it (assumed)", "low"
)
SMALLEST_FEATURE = Rule("smallest_feature", "mm", "assumed: nothing is published for soft resin", "low")
WALL = Rule("wall", "mm", GUIDE, "medium")
SOFT_WALL = Rule("wall", "mm", DOUBLED, "low")
OPEN_HOLE = Rule("hole", "mm", GUIDE, "medium")
SOFT_HOLE = Rule("hole", "mm", DOUBLED, "low")
NO_OVERHANG = Rule(
    "overhang", "deg", f"{GUIDE}; a warning below {SOFT_OVERHANG:g} for soft resin (assumed)", "low"
)
TRAPPED_VOLUME = Rule("trapped_volume", "mm", f"drain hole of {GUIDE}", "medium")
MOUNT = Rule("mount", "mm", "the adapter's own dimensions", "high")
