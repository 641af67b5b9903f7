"""The topics of a recording: what each holds, of which type and with which schema."""

from dataclasses import dataclass
from typing import Any

from probedesign.estimation.estimate import RESULTS
from probedesign.live.mcap.messages import POSE, TEXT, UNCERTAIN_POSE, WRENCH
from probedesign.live.row import COLUMNS, WORLD_COLUMNS

OURS = "probedesign"
"""Metadata of this name stand in our recordings."""


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic.

    Attributes:
        name: in ROS.
        type: of its messages.
        schema: of the JSON that its strings hold, as JSON Schema; empty where they hold none.
    """

    name: str
    type: str
    schema: dict[str, Any]


def _object(title: str, required: list[str], properties: dict[str, Any]) -> dict[str, Any]:
    """A JSON Schema of one flat object; what it does not name may be there too."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object"}
    return head | {"properties": properties, "required": required}


NUMBER = {"type": "number"}
NUMBER_OR_NULL = {"type": ["number", "null"]}
TEXT_VALUE = {"type": "string"}
NUMBERS = {"type": "array", "items": NUMBER}

RAW = Topic("/probedesign/wrench_raw", WRENCH, {})
"""Every reading as the sensor gave it, in its frame, bias included."""
BLOCK = Topic(
    "/probedesign/block",
    TEXT,
    _object(
        "Readings that came together: the raw wrenches since the last of these, and what their headers cannot tell",
        ["first", "time_s", "gravity_base_m_s2", "stretch", "fault"],
        {
            "first": {
                "type": "integer",
                "description": "readings before it, those included that were left out",
            },
            "time_s": {**NUMBERS, "description": "of each, by the source's clock, to the last bit"},
            "gravity_base_m_s2": {**NUMBERS, "minItems": 3, "maxItems": 3},
            "stretch": {"type": "integer", "description": "counts what was read without an interruption"},
            "fault": {**TEXT_VALUE, "description": "what is wrong with all of them; empty if nothing"},
        },
    ),
)
WITHOUT_BIAS = Topic("/probedesign/wrench", WRENCH, {})
"""What was estimated from: without bias, averaged, at the base."""
CONTACT = Topic("/probedesign/contact", UNCERTAIN_POSE, {})
"""The touched point in the base frame, with each result `ok`."""
CONTACT_WORLD = Topic("/probedesign/contact_world", UNCERTAIN_POSE, {})
"""The touched point of all readings of a touch, with each fused result `ok`."""
BASE = Topic("/probedesign/base", POSE, {})
"""Each pose of the base in the world that counts, by the source's clock."""
ESTIMATE = Topic(
    "/probedesign/estimate",
    TEXT,
    _object(
        "What the probe says; null where the result does not tell",
        ["time_s", "result"],
        {
            **{name: NUMBER_OR_NULL for name in (*COLUMNS, *WORLD_COLUMNS)},
            **{name: TEXT_VALUE for name in ("phase", "fused_result", "stale")},
            "time_s": NUMBER,
            "result": {"enum": list(RESULTS)},
            "T_world_base": {"type": "array", "items": NUMBERS, "description": "4 × 4, where it is known"},
        },
    ),
)
EVENT = Topic(
    "/probedesign/event",
    TEXT,
    _object("An event", ["event"], {"time_s": NUMBER_OR_NULL, "event": TEXT_VALUE}),
)
"""Tares, marks, silence, loss, faults."""
TOPICS = (RAW, BLOCK, WITHOUT_BIAS, CONTACT, CONTACT_WORLD, BASE, ESTIMATE, EVENT)
