"""The life of a job in a child process, whatever it does: a tick at a time until it has ended."""

from __future__ import annotations

from abc import ABC, abstractmethod

from hnf_core.errors import HnfError

from ..state.session import STATE, LastJob
from .child import ChildProcess
from .messages import Finished, Message


class ChildJob(ABC):
    """Call tick() every 0.1 s until it says how it ended. what: whose end is told. killed: what to do after it died."""

    process_name: str
    killed_remedy: str
    _child: ChildProcess | None = None

    @property
    def pid(self) -> int | None:
        """Of the child process, None when it is gone."""
        return None if self._child is None else self._child.pid

    def tick(self) -> LastJob | None:
        """Go on for a moment; STATE.job tells how far. None while it runs, else how it ended, told in STATE.last_job
        too, and nothing of it is left."""
        try:
            ended = self._advance()
        except HnfError as error:
            ended = LastJob(False, str(error))
        except BaseException:
            self.cancel()
            raise
        return None if ended is None else self._finish(ended)

    @abstractmethod
    def cancel(self) -> LastJob:
        """Stop now; nothing is changed."""

    @abstractmethod
    def clean_up(self) -> None:
        """End the child, and leave nothing of it."""

    @abstractmethod
    def _on_message(self, message: Message, child: ChildProcess) -> LastJob | None:
        """How it ended, where the message says so. After Finished none is listened to."""

    def _advance(self) -> LastJob | None:
        return self._poll_messages()

    def _finish(self, outcome: LastJob) -> LastJob:
        self.clean_up()
        STATE.last_job = outcome
        return outcome

    def _poll_messages(self) -> LastJob | None:
        child = self._child
        if child is None:
            return LastJob(False, "It has ended already.")
        code = child.exit_code()  # before its messages are read: what it said last is among them
        for message in child.messages():
            ended = self._on_message(message, child)
            if ended is not None or isinstance(message, Finished):
                return ended
        if code is None:
            return None
        how = f"was killed (signal {-code})" if code < 0 else f"ended with code {code}"
        return LastJob(False, f"{self.process_name} {how} before it was done. {self.killed_remedy}", child.last_lines)
