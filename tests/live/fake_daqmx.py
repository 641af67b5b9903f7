"""A simulated NI driver: the interpreter that nidaqmx calls below its own classes, without a card.

It responds as NI documents it: arrays grouped by channel, a read that waits for its samples or fails with -200284,
rates that the card's clock divides, one owner of a task. Samples become available one after the other as they are
read; a script of events replaces some of them.
"""

from collections.abc import Callable

import numpy as np
from nidaqmx.constants import AcquisitionType, FillMode, TerminalConfiguration, VoltageUnits
from nidaqmx.errors import DaqError, DaqReadError

CLOCK = 100e6
DEVICE_NAMES, AVAILABLE, CHANNEL_COUNT, SAMPLE_RATE, TASK_NAME = 0x193B, 0x1223, 0x217B, 0x1344, 0x1276


class FakeDriver:
    """One card.

    Attributes:
        volts: of the gauges at the i-th sample since the acquisition began, of so many of them.
        script: at the n-th read, counted from 0, happens a DAQmx error code instead.
        waiting: samples that are there before a read waits.
        tasks: open ones.
        asked: what was set up, of the last task.
        starts: how often an acquisition began.
    """

    driver_version = (24, 5)

    def __init__(self, volts: Callable[[np.ndarray], np.ndarray], names: str = "Dev1, Dev2"):
        self.volts, self.names = volts, names
        self.script: dict[int, int] = {}
        self.tasks, self.asked = set(), {}
        self.waiting = self.starts = self.reads = self.taken = 0

    def get_system_info_attribute_string(self, attribute):
        assert attribute == DEVICE_NAMES
        return self.names

    def create_task(self, name):
        handle = f"task{len(self.tasks)}"
        self.tasks.add(handle)
        return handle, True

    def clear_task(self, handle):
        self.tasks.remove(handle)

    def get_task_attribute_string(self, handle, attribute):
        return handle

    def get_task_attribute_uint32(self, handle, attribute):
        return 6

    def create_ai_voltage_chan(self, handle, channel, name, terminal, low, high, units, scale):
        assert units == VoltageUnits.VOLTS.value and not scale
        self.asked = {"channel": channel, "terminal": TerminalConfiguration(terminal), "reach": (low, high)}

    def internal_get_last_created_chan(self):
        raise NotImplementedError

    def cfg_samp_clk_timing(self, handle, rate, source, edge, mode, buffer):
        assert AcquisitionType(mode) is AcquisitionType.CONTINUOUS
        self.asked |= {"rate": CLOCK / round(CLOCK / rate), "buffer": buffer}

    def get_timing_attribute_double(self, handle, attribute):
        assert attribute == SAMPLE_RATE
        return self.asked["rate"]

    def get_read_attribute_uint32(self, handle, attribute):
        return {AVAILABLE: self.waiting, CHANNEL_COUNT: 6}[attribute]

    def start_task(self, handle):
        assert handle in self.tasks
        self.starts, self.taken = self.starts + 1, 0

    def read_analog_f64(self, handle, count, timeout, fill, data):
        assert handle in self.tasks and self.starts and fill == FillMode.GROUP_BY_CHANNEL.value
        assert data.shape == (6, count) and data.flags.c_contiguous
        code = self.script.get(self.reads)
        self.reads += 1
        if code is not None:
            raise (DaqReadError("Driver message.", code, 0) if code == -200284 else DaqError("Driver message.", code))
        data[:] = self.volts(self.taken + np.arange(count)).T
        self.taken += count
        return data, count
