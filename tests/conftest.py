"""Settings of every test: property tests draw the same examples each run; the clock judges none."""

import pytest
from hypothesis import settings

from probedesign.cli.main import use_one_blas_thread

use_one_blas_thread()  # as every command does, before numpy is imported: waiting threads take the other worker's core
settings.register_profile("probedesign", deadline=None, max_examples=100, derandomize=True)
settings.load_profile("probedesign")

#: Files that take longest. They come first, so that at the end no worker waits for another with a long one.
LONGEST = (
    "tests/test_docs.py", "tests/studio/test_page.py", "tests/reports/test_every_page.py",
    "tests/live/test_view_page.py", "tests/live/test_payload.py", "tests/identification/test_fit_checks.py",
    "tests/mapping/test_explore.py", "tests/cad/test_export.py", "tests/cad/test_parts.py",
    "tests/optimization/test_optimum.py", "tests/cad/test_documents.py", "tests/printing/test_layers.py",
    "tests/mapping/test_next_touch.py", "tests/identification/test_mistakes.py",
    "tests/estimation/test_curved_touches.py", "tests/planning/test_plan.py", "tests/live/test_shutdown.py",
    "tests/mapping/test_shapes.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of the longest files first; `python -m tests` keeps this order among its workers."""
    rank = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.location[0], len(rank)))
