"""The workers, by dask.distributed, which is imported here and nowhere else.

dask's own messages are pickled: whoever reaches a scheduler's port can run anything on its workers. A cluster made here
listens to 127.0.0.1 alone. What the batch itself sends and takes is text.
"""

from __future__ import annotations

import contextlib
import logging
import re
import signal
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from multiprocessing import resource_tracker
from typing import Any

from ..errors import HnfError, UsageError
from .attempt import explain_unsuitable_worker, run_attempt
from .order import Outcome, Request, State, encode_message, parse_outcome

HOST = "127.0.0.1"
CONNECT_S, START_S, CLOSE_S = 10.0, 60.0, 10.0
ADDRESS_PATTERN = re.compile(r"(tcp|tls)://\S+:\d+")


def check_address(address: str) -> None:
    """Raises UsageError where it is no scheduler's."""
    if not ADDRESS_PATTERN.fullmatch(address):
        raise UsageError(
            f"--scheduler {address!r} is no address.", remedy="Example: --scheduler tcp://192.168.1.5:8786"
        )


@contextlib.contextmanager
def connect_workers(address: str | None, worker_count: int, retries: int) -> Iterator[Any]:
    """A distributed.Client: of the scheduler at address, or of count worker processes that live as long as this.

    retries: how often a job may lose its worker. Raises HnfError where dask is not there or no scheduler answers.
    """
    dask, distributed = _import_dask()
    with contextlib.ExitStack() as stack:
        if address is None:
            address = stack.enter_context(
                _start_local_cluster(dask, distributed, worker_count, retries)
            ).scheduler_address
        try:
            client = distributed.Client(
                address,
                timeout=CONNECT_S,
                set_as_default=False,
                serializers=["msgpack", "pickle"],
                deserializers=["msgpack"],  # whatever a worker answers with: text, or nothing
            )
        except (OSError, ValueError) as error:
            raise HnfError(
                f"no scheduler answers at {address} ({error}).",
                remedy="Start one there with: dask scheduler; and workers with: dask worker ADDRESS.",
            ) from error
        stack.callback(_close_client, client)
        yield client


@contextlib.contextmanager
def _start_local_cluster(dask: Any, distributed: Any, worker_count: int, retries: int) -> Iterator[Any]:
    settings = {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.scheduler.worker-saturation": 1.0,  # none waits on a worker: a dying one takes one job with it
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with (
        tempfile.TemporaryDirectory(prefix="hnf-batch-", ignore_cleanup_errors=True) as scratch,
        dask.config.set(settings),
    ):
        with _block_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=worker_count,
                threads_per_worker=1,
                processes=True,
                host=HOST,
                dashboard_address=None,
                worker_dashboard_address=None,
                scheduler_kwargs={"dashboard_address": f"{HOST}:0"},
                memory_limit=None,  # it would count the worker's memory, which is not that of its command
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
            )
        with cluster:
            yield cluster


@contextlib.contextmanager
def _block_interrupts() -> Iterator[None]:
    """Ctrl-C waits, and what is started meanwhile never hears it, nor what that starts: a terminal sends it to every
    process, and workers are ended by ours."""
    resource_tracker.ensure_running()  # where multiprocessing starts it later, it lets interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def check_workers(client: Any, folder: str, run: str, version: str, paths: Sequence[str]) -> int:
    """How many workers there are. Raises HnfError where there are none, or where one of them does not see the folder or
    a file, or has another version of hnf."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise HnfError(
            "the scheduler has no workers.", remedy="Start some, on machines that see the files: dask worker ADDRESS."
        ) from error
    try:
        told = client.run(explain_unsuitable_worker, folder, run, version, list(paths))
    except Exception as error:  # whatever it was there, it came over the wire
        raise HnfError(
            f"hnf does not run on every worker ({error!r}).",
            remedy="Install this version of hnf[batch] on each machine.",
        ) from error
    for worker, why in told.items():
        if why != "":
            raise HnfError(str(why), where=f"worker {worker}")
    return len(told)


def run_requests(client: Any, requests: Sequence[Request]) -> Iterator[Outcome]:
    """Each attempt as it ends. One that met with an accident is given out again, as often as its order says: see
    Order.is_tried_again."""
    _, distributed = _import_dask()
    waiting = {_submit(client, order): order for order in requests}
    ended = distributed.as_completed(list(waiting), loop=client.loop)
    for future in ended:
        order = waiting.pop(future)
        outcome = _read_outcome(future, order)
        future.release()
        if order.should_retry(outcome):
            again = replace(order, earlier=(*outcome.earlier, outcome.why))
            future = _submit(client, again)
            waiting[future] = again
            ended.add(future)
        yield outcome


def _submit(client: Any, request: Request) -> Any:
    return client.submit(
        run_attempt, encode_message(request), pure=False, key=f"hnf-{request.run}-{request.name}-{len(request.earlier)}"
    )


def _read_outcome(future: Any, request: Request) -> Outcome:
    if future.status == "finished":
        try:
            return parse_outcome(future.result())
        except (HnfError, OSError, TypeError, ValueError) as error:
            return Outcome(
                request.name, State.UNSEEN, f"a worker's answer is no text ({error}).", earlier=request.earlier
            )
    if future.status != "error":
        return Outcome(request.name, State.UNSEEN, "the scheduler was lost", earlier=request.earlier)
    # The scheduler has given up: the job's workers died under it more often than it allows.
    lost = "its worker was lost"
    return Outcome(
        request.name, State.ACCIDENT, lost, earlier=(*request.earlier, *[lost] * request.retries)[: request.retries]
    )


def _import_dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise HnfError(
            f"batch needs dask.distributed ({error}).",
            remedy="In a checkout: make env-test; elsewhere: pip install 'hnf[batch]'.",
        ) from error
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what becomes of a job is told by the batch
    return dask, distributed


def _close_client(client: Any) -> None:
    with contextlib.suppress(OSError, TimeoutError):
        client.close(timeout=CLOSE_S)
