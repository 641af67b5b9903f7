"""`probedesign live`: contacts as the sensor reads them."""

from pathlib import Path

from probedesign.cli.output import print_json


def live(bundle: Path, /, *, source: str, record: Path | None = None, view: bool = False) -> None:
    """Locate contacts as the sensor reads them.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        source: netft://HOST, daq://Dev1/ai0:5?cal=FILE, replay:FILE or sim:
        record: write what the sensor reads to this file.
        view: show the probe in the browser.
    """
    from probedesign import pipeline

    print_json(pipeline.live(bundle, source, record, view))  # lead completes
