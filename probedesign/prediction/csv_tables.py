"""A prediction as tables that a spreadsheet reads: one of all conditions, one along the probe."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from probedesign.prediction.fused_budget import FUSED_CAUSES
from probedesign.prediction.predict import Detection, Prediction
from probedesign.prediction.reach import Reach

Row = Mapping[str, Any]


def conditions_csv(prediction: Prediction) -> bytes:
    """A row a condition, single touches (touches = 1) and fused ones; the budget's causes are its last columns."""
    single = [{"touches": 1, **asdict(c)} for c in prediction.conditions]
    rows = [_spread(row) for row in [*single, *(asdict(c) for c in prediction.fused)]]
    first = ["contact_fraction", "force_N", "direction", "touches", "result"]
    causes = [_column(cause) for cause in FUSED_CAUSES]
    between = [
        name for name in dict.fromkeys(k for row in rows for k in row) if name not in (*first, *causes)
    ]
    return _csv([*first, *between, *causes], rows)


def along_csv(prediction: Prediction) -> bytes:
    """A row a place and side: what is felt, what accuracy costs, where it ends; fused_ is of fused touches."""
    rows: dict[tuple[float, str], dict[str, Any]] = {}
    shown: tuple[Detection | Reach, ...] = (*prediction.detection, *prediction.reach)
    for one in shown:
        rows.setdefault((one.contact_fraction, one.direction), {}).update(asdict(one))
    for fused in prediction.fused_reach:
        forces = {f"fused_{k}": v for k, v in asdict(fused).items() if k.startswith("force_")}
        rows[fused.contact_fraction, fused.direction].update(forces)
    for path in prediction.workspace.paths:
        rows[path.contact_fraction, path.direction]["pressed_mm"] = path.pressed_mm
    names = list(dict.fromkeys(k for row in rows.values() for k in row))
    return _csv(names, list(rows.values()))


def _spread(row: dict[str, Any]) -> dict[str, Any]:
    """The budget's causes as columns of their own."""
    budget = row.pop("budget_mm") or {}
    return row | {_column(cause): value for cause, value in budget.items()}


def _column(cause: str) -> str:
    return f"budget_{cause.replace(' ', '_')}_mm"


def _csv(names: Sequence[str], rows: Sequence[Row]) -> bytes:
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return text.getvalue().encode()
