"""Play haptic signals on actuators: a source of acceleration [m/s²] becomes limited int16 counts on a device.

Read `sink.py` (the device interface) and `stream.py` (the playing thread) first. `measure/` measures an actuator,
`sinks/` talks to devices. The files `virtual_…` simulate one: what it does (`virtual_serial_device.py`), how it moves
(`virtual_transducer.py`), and a pty by which a host connects (`virtual_port.py`).
"""
