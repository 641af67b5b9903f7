"""A sensor whose gauges are read by a card of National Instruments: `daq://`, through nidaqmx."""
