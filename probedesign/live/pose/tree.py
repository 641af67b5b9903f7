"""Frames that hang on each other, as TF tells them: where one is in another, over time."""

from probedesign.errors import InputError
from probedesign.frames import Array, inverse
from probedesign.live.pose.timed import TimedPose, matrix, of_matrix
from probedesign.live.pose.track import Track


class Tree:
    """Edges from parent to child, each still or with its own stamps."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._still: dict[str, Array] = {}
        self._moving: dict[str, Track] = {}

    def add(self, parent: str, child: str, pose: TimedPose, still: bool) -> None:
        """Take in where a child is in its parent.

        Raises:
            InputError: the child hangs on another parent already.
        """
        if self._parent.setdefault(child, parent) != parent:
            raise InputError(
                f"frame {child[:40]!r} hangs on {self._parent[child][:40]!r} and on {parent[:40]!r}"
            )
        if still:
            self._still[child] = matrix(pose)
        else:
            self._moving.setdefault(child, Track()).add(pose)

    def poses(self, world: str, base: str) -> list[TimedPose]:
        """Where `base` is in `world`, at every stamp of an edge that moves between them.

        Raises:
            InputError: they do not hang together, or nothing between them moves.
        """
        up, down = self._to_root(world), self._to_root(base)
        shared = next((frame for frame in down if frame in up), None)
        if shared is None:
            known = ", ".join(sorted({*self._parent, *self._parent.values()}))[:200] or "none"
            raise InputError(f"TF does not join {world!r} and {base!r}; frames: {known}")
        up, down = up[: up.index(shared)], down[: down.index(shared)]
        times = {
            time for child in (*up, *down) if child in self._moving for time in self._moving[child].times
        }
        found = []
        for time in sorted(times):
            to_world, to_base = self._chained(up, time), self._chained(down, time)
            if to_world is not None and to_base is not None:
                found.append(of_matrix(time, inverse(to_world) @ to_base))
        if not found:
            raise InputError(f"TF never tells where {base!r} is in {world!r} at one time; is it all static?")
        return found

    def _to_root(self, frame: str) -> list[str]:
        """The frame, its parent, the parent's parent and so on."""
        chain = [frame]
        while (parent := self._parent.get(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def _chained(self, children: list[str], time: float) -> Array | None:
        """T from the first child to the parent of the last, (4, 4)."""
        T: Array | None = matrix(TimedPose(time, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
        for child in children:
            edge = self._still.get(child)
            edge = self._moving[child].at(time) if edge is None else edge
            if edge is None or T is None:
                return None
            T = edge @ T
        return T
