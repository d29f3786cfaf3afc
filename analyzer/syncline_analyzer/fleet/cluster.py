"""Processes that work: of this machine, or of any Dask cluster by its address."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import dask.config
from distributed import Client, LocalCluster
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend

from syncline_schemas.errors import SourceError, UsageError
from syncline_schemas.processors import processors

LOOPBACK = "127.0.0.1"
KILLS = 3
"""So often a worker may die over one capture before it is given up."""
_TRY_S = 10.0
_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")
OWN_WORKER = "syncline_analyzer.fleet.own_worker"
_OWN_WORKERS = {
    "distributed.scheduler.allowed-failures": KILLS - 1,
    # A sampling profiler that nobody looks at.
    "distributed.worker.profile.enabled": False,
    # Looks at itself that cost each process 1 to 2 % of a core: at its event loop 50 times a second,
    # at its memory 10 times, at the system twice.
    "distributed.admin.tick.interval": "1s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
    # Without Dask's MALLOC_TRIM_THRESHOLD_: an analysis takes again what it has just freed.
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": 1,
        "MKL_NUM_THREADS": 1,
        "OPENBLAS_NUM_THREADS": 1,
    },
}
Connect = Callable[[], Client]


@contextmanager
def cluster(scheduler: str | None, workers: int | None) -> Iterator[Connect]:
    """A way to connect to a cluster; what was started for it ends with the context.

    Args:
        scheduler: address of a scheduler, None for processes of this machine.
        workers: so many of these; by default one for each processor.

    Raises:
        UsageError: the address is none.
    """
    with _quiet():
        if scheduler is not None:
            yield lambda: _client(scheduler)
            return
        with (
            dask.config.set(_OWN_WORKERS),
            LocalCluster(
                n_workers=workers or processors(),
                threads_per_worker=1,
                processes=True,
                host=LOOPBACK,
                dashboard_address=None,
                # Without it Dask takes port 8787, which another run may have.
                scheduler_kwargs={"dashboard_address": f"{LOOPBACK}:0"},
                silence_logs=logging.CRITICAL,
                preload=[*_preloads(), OWN_WORKER],
            ) as started,
        ):
            yield lambda: _client(started)


def _preloads() -> list[str]:
    """What the user's Dask configuration has workers load; a file, or a list of them."""
    told = dask.config.get("distributed.worker.preload")
    return [told] if isinstance(told, str) else list(told)


def _client(address: str | LocalCluster) -> Client:
    """A new connection. Raises: SourceError where nobody answers, UsageError for no address."""
    try:
        if isinstance(address, str):
            _check_address(address)
        with warnings.catch_warnings():
            # Different versions of packages that do not matter here.
            warnings.simplefilter("ignore")
            return Client(address, timeout=_TRY_S, set_as_default=False)
    except ValueError as error:
        raise UsageError(
            f"--scheduler {address}: is no address; write it as tcp://host:8786"
        ) from error
    except OSError as error:
        raise SourceError(f"no Dask scheduler answers at {address}") from error


def _check_address(address: str) -> None:
    """Raises: ValueError, it is none; a client that finds out itself leaves a traceback behind."""
    scheme, where = parse_address(address)
    get_backend(scheme)
    parse_host_port(where)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the words of Dask to itself: what matters of them is said as what came of a capture."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
