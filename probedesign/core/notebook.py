"""How results show themselves in a notebook: the methods of their classes.

What is shown of each class is in `reports.notebook`, which knows all of them and stands above them; it is imported by
its name when a method is called, so that an estimate of a stream loads neither charts nor pages.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


class Displayed:
    """A result with a short table and a picture."""

    def _repr_html_(self) -> str:
        """Return the table and the picture as HTML, which Jupyter shows."""
        return str(_views().html_of(self))

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """Return the same as HTML and as text, which IPython shows in a terminal and a notebook keeps."""
        return {"text/html": self._repr_html_(), "text/plain": str(_views().text_of(self))}

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the picture with matplotlib.

        Args:
            ax: axes to draw into; new ones if None.

        Returns:
            The axes. Without a picture, such as of a reading without contact, they are empty and the title names the
            reason.

        Raises:
            MissingDependencyError: matplotlib is not installed.
        """
        return _views().plot_of(self, ax)  # type: ignore[no-any-return]


class Tabular(Displayed):
    """A result that is also a table."""

    def to_dataframe(self) -> "DataFrame":
        """Return the result as a pandas table; the name of each column ends in its unit.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        return _views().dataframe_of(self)


def _views() -> Any:
    return import_module("probedesign.reports.notebook")
