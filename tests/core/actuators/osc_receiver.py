"""A receiver of OSC on this machine: a real socket, python-osc's own decoder."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Receiver:
    """got: (seconds, address, value), as they came."""

    port: int
    got: list[tuple[float, str, float]] = field(default_factory=list)

    @property
    def target(self) -> str:
        return f"osc:127.0.0.1:{self.port}"

    def values(self, address: str) -> list[float]:
        return [value for _, name, value in list(self.got) if name == address]

    def wait_for(self, count: int, address: str, seconds: float = 10.0) -> list[float]:
        """The values at address, at least count of them."""
        until = time.monotonic() + seconds
        while len(self.values(address)) < count and time.monotonic() < until:
            time.sleep(0.005)
        assert len(self.values(address)) >= count, f"{len(self.values(address))} of {count} messages came"
        return self.values(address)

    def settled(self, seconds: float = 0.3) -> None:
        """Wait until nothing has come for so long."""
        count = -1
        while count != len(self.got):
            count = len(self.got)
            time.sleep(seconds)


@contextmanager
def receiver() -> Iterator[Receiver]:
    from pythonosc.osc_message import OscMessage

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(0.1)
        found = Receiver(ear.getsockname()[1])
        ending = threading.Event()

        def listen() -> None:
            while not ending.is_set():
                try:
                    message = OscMessage(ear.recv(2048))
                except TimeoutError:
                    continue
                found.got.append((time.monotonic(), message.address, *message.params))

        thread = threading.Thread(target=listen)
        thread.start()
        try:
            yield found
        finally:
            ending.set()
            thread.join()
