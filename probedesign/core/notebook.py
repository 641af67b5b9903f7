"""How results show themselves in a notebook: the methods of their classes.

What is shown of each class is in `reports.notebook`, which knows all of them and stands above them. The package's
`__init__` states where it is; it is imported when a method is called, so that an estimate of a stream loads no charts.
"""

TYPE_CHECKING = False  # as in typing, which `import probedesign` does not load
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, Protocol

    from matplotlib.axes import Axes
    from pandas import DataFrame

    class Views(Protocol):
        """What `reports.notebook` shows of a result."""

        def views_of(self, result: object) -> dict[str, str]: ...
        def plot_of(self, result: object, ax: Axes | None) -> Axes: ...
        def dataframe_of(self, result: object) -> DataFrame: ...


_views: "Callable[[], Views]"


def set_views(load: "Callable[[], Views]") -> None:
    """State what imports the functions that show results; `probedesign/__init__.py` calls this."""
    global _views
    _views = load


class Displayed:
    """A result with a short table and a picture."""

    def _repr_html_(self) -> str:
        return self._repr_mimebundle_()["text/html"]

    def _repr_mimebundle_(self, include: "Any" = None, exclude: "Any" = None) -> dict[str, str]:
        return _views().views_of(self)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the picture with matplotlib into axes, new ones if None, and return them; they may be empty.

        Raises:
            MissingDependencyError: matplotlib is not installed.
        """
        return _views().plot_of(self, ax)


class Tabular(Displayed):
    """A result that is also a table."""

    def to_dataframe(self) -> "DataFrame":
        """Return the result as a pandas table; the name of each column ends in its unit.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        return _views().dataframe_of(self)
