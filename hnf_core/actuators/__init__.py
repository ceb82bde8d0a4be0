"""Play haptic signals on actuators: a source of acceleration [m/s²] becomes limited int16 counts on a device.

Read `sink.py` (the device interface) and `stream.py` (the playing thread) first. `measure/` measures an actuator,
`sinks/` talks to devices and `virtual/` simulates one.
"""
