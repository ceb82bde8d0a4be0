"""A virtual actuator: the device's side of the serial protocol, a resonant transducer, and a pty as the port.

Read `serial_device.py` first (what a device does), then `transducer.py` (how it moves) and `port.py` (how a host
connects).
"""
