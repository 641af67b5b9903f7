"""What `optimize` hands back: the best body beside its start, confirmed if that was asked for, with its file."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from probedesign.design_file import render_design
from probedesign.search.confirm import Confirmed
from probedesign.search.front import Front
from probedesign.search.grid import tables_of
from probedesign.search.optimum import Optimum, Search


@dataclass(frozen=True)
class Found:
    """All of it.

    Attributes:
        search: what was sought.
        optimum: the best body.
        confirmed: start and best by drawn touches; None if not asked for, or of a start that gives way.
        front: None if not asked for.
        files: written.
    """

    search: Search
    optimum: Optimum
    confirmed: tuple[Confirmed | None, Confirmed] | None
    front: Front | None
    files: tuple[Path, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        best, confirmed = self.optimum, self.confirmed
        return {
            "schema": 1,
            "goal": self.search.goal,
            "task": asdict(best.task),
            "subject_to": [limit.text for limit in self.search.limits],
            "start": best.before.as_dict(),
            "best": best.after.as_dict(),
            "design": tables_of(best.design),
            "binding": list(best.binding),
            "bodies_looked_at": best.looked,
            "worse_than_start": [asdict(row) for row in best.worse],
            "confirmed": None
            if confirmed is None
            else {
                name: None if one is None else asdict(one)
                for name, one in zip(("start", "best"), confirmed, strict=True)
            },
            "front": None if self.front is None else self.front.rows,
            "files": [str(file) for file in self.files],
        }


def design_text(search: Search, found: Optimum) -> str:
    """The design file of the best body; its head says what it is best for."""
    before, after = found.before.error_mm, found.after.error_mm
    was = "none: it gives way" if before is None else f"{before:.3g} mm"
    kept = ", ".join(limit.text for limit in search.limits) or "no limits of its own"
    about = (
        f"Found by optimize, {search.goal}, from {search.start.name}; {kept}.\n"
        f"{found.task.text}:\npredicted error {after:.3g} mm, all causes; of {search.start.name} {was}."
    )
    return render_design(found.design, {"": about})
