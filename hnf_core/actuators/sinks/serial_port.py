"""A serial port, taken for one program alone; what can go wrong with that in words."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from ...errors import DeviceError
from ..libraries import import_optional

READ_TIMEOUT_S = 0.02
"""Longest that a read waits for the first byte."""

WRITE_TIMEOUT_S = 0.1
"""Longest that a write waits for a device that does not read."""


def open_port(port: str, baudrate: int) -> Any:
    """A serial.Serial in raw mode, whatever lay in its buffers dropped.

    Raises DeviceError where there is no such port, another program has it, or we may not.
    """
    serial = import_optional("serial")
    try:
        opened = serial.Serial(port, baudrate, timeout=READ_TIMEOUT_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise _make_open_error(port, baudrate, error) from error
    except Exception as error:  # termios.error is no OSError, and Windows has no termios
        raise DeviceError(
            f"is no serial port ({error}).", where=port, remedy=f"Choose one of these: {_list_ports()}."
        ) from error
    try:
        opened.reset_input_buffer()
        opened.reset_output_buffer()
    except Exception as error:
        opened.close()
        raise make_disconnected_error(port, error) from error
    return opened


def make_disconnected_error(port: str, error: Exception) -> DeviceError:
    """What a port that was open says when its plug is pulled."""
    words = _format_reason(error)
    return DeviceError(
        f"the device is gone{'' if 'returned no data' in words else f' ({words})'}.",
        where=port,
        remedy="Check cable and power, plug it in again, then start again.",
    )


def _make_open_error(port: str, baudrate: int, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    words = str(error)
    # pyserial hands on Windows' reason in the text only: no such file, access denied.
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in words:
        return DeviceError(
            "there is no such port.", where=port, remedy=f"Plug the device in, or choose one of these: {_list_ports()}."
        )
    if number in (errno.EAGAIN, errno.EBUSY) or "PermissionError" in words:
        return DeviceError("another program uses this port.", where=port, remedy=f"Close {_find_port_user(port)}.")
    if number in (errno.EACCES, errno.EPERM):
        return DeviceError(
            "this user may not open the port.",
            where=port,
            remedy="On Linux: sudo usermod -aG dialout $USER (uucp on Arch), then log out and in again.",
        )
    if isinstance(error, ValueError):
        return DeviceError(f"cannot run at {baudrate} baud ({error}).", where=port, remedy="Choose another rate.")
    return DeviceError(
        f"cannot be opened ({_format_reason(error)}).", where=port, remedy=f"Known ports: {_list_ports()}."
    )


def _list_ports() -> str:
    from serial.tools import list_ports

    return ", ".join(sorted(found.device for found in list_ports.comports())) or "none is connected"


def _find_port_user(port: str) -> str:
    """Who has port open, as far as Linux lets us know."""
    found, device = [], os.path.realpath(port)
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        process = link.parents[1]
        try:
            if os.readlink(link) == device:
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:
            continue
    return " and ".join(sorted(set(found))) or "it (another stream, a serial monitor, a modem manager)"


def _format_reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
