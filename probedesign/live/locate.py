"""The estimate of one reading of the sensor."""

from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.live.reading import Reading
from probedesign.live.tare import Tare, without_bias


def locate(estimator: Estimator, read: Reading, tare: Tare | None = None, method: Method = "ml") -> Estimate:
    """Return the estimate of one reading; a channel at its limit counts as read, before the bias is taken off.

    The variance of the bias grows with the age of the tare.

    Args:
        estimator: of the probe.
        read: bias included.
        tare: of the bias; None where none was taken.
        method: as in `Estimator.estimate`.
    """
    if read.fault or not estimator.model.reads(read.wrench_sensor):
        return Estimate("out_of_range")
    reading = without_bias(read, tare)
    wrench_base = estimator.model.to_base(reading.wrench_sensor, reading.gravity_base)
    if tare is not None:
        estimator = estimator.since_tare(read.time - tare.time)
    return estimator.estimate(wrench_base, reading.gravity_base, method=method)
