"""Engines that run the jobs of a build: local processes, or a Dask cluster. `submit` returns a future."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import connection, forkserver, resource_tracker
from typing import Any, NoReturn

from datagen.errors import CheckError, InputError
from datagen.exit_status import Ended
from datagen.records.checks import as_given

MOST_WORKERS = 4096
PATIENCE_S = 3.0
"""Seconds that a worker has to end after SIGTERM before it is killed: enough to sync a shard to a disk."""
COUNT_S = 0.5
"""Seconds between two counts of a cluster's workers, which come and go: as often as a build looks at its jobs."""
RETURN_S = 300.0
"""Seconds that a build waits for a lost Dask scheduler: a restart may have to queue in SLURM."""
OF_WORKERS = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "DATAGEN_SAID_OF_CACHE"), "1"
)
"""Environment variables of worker processes: each uses one core, because a sum that is split over threads could round
differently, and leaves it to this process to say where kernels are cached (`compiled.SAID`)."""

_CONTEXT = multiprocessing.get_context("forkserver")
"""Workers fork from a server process that has imported the modules they need. The server's only thread is that of
Arrow's allocator, which is safe to fork."""


def start_imports(*modules: str) -> None:
    """Start the server process from which local workers fork, and its imports of these modules, without waiting.

    Raises `InputError` if the path of the temporary folder is too long for a socket.
    """
    _CONTEXT.set_forkserver_preload(list(modules))
    with _starting():
        forkserver.ensure_running()


@contextmanager
def _starting() -> Iterator[None]:
    """A context in which processes are started: with the environment of a worker, and without being interrupted.
    Raises `InputError` without a temporary folder for their socket, and if its path is too long."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError as error:
        raise InputError(
            f"TMPDIR: workers need a temporary folder ({error.strerror}); set TMPDIR to one that you may write to"
        ) from None
    # Before the block: Python up to 3.12 unblocks Ctrl-C when it has started its tracker of semaphores.
    resource_tracker.ensure_running()
    try:
        with _environment(OF_WORKERS), _signals_deferred():
            yield
    except OSError as error:
        # Only an address that is too long for a socket has no number.
        if error.errno is not None:
            raise
        raise InputError(
            f"TMPDIR: workers cannot be started, since their socket lies in {tempfile.gettempdir()} ({error}); set "
            "TMPDIR to a shorter path, such as /tmp"
        ) from None


class WorkerDied(Exception):
    """The process of a job ended before the job did.

    seconds : between the beginning of the job and the death; None if the worker died before the job began.
    """

    def __init__(self, seconds: float | None) -> None:
        super().__init__("a worker process died")
        self.seconds = seconds


class LocalProcesses:
    """Worker processes on this machine, each with a pipe of its own: if one dies, only its job is lost, and this job
    is known to be the cause.

    capacity : number of jobs that should be under way at once.
    deaths : the exceptions of a future whose worker died. Other exceptions come from the job itself.
    shares_shards : whether several workers may make the scenes of one shard, because results return cheaply.
    """

    deaths: tuple[type[BaseException], ...] = (WorkerDied,)
    shares_shards = True

    def __init__(self, workers: int) -> None:
        self.capacity = workers
        # One thread waits for each worker.
        self._threads = ThreadPoolExecutor(workers)
        self._workers: list[_Worker] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """The future of a job; at most `capacity` jobs may be under way."""
        worker = next((worker for worker in self._workers if not worker.died and worker.job.done()), None)
        if worker is None:
            with _starting():
                worker = _Worker()
                self._workers.append(worker)
        worker.job = self._threads.submit(worker.run, function, arguments)
        return worker.job

    def restore(self, say: Callable[[str], None]) -> None:
        """Nothing cancels a job here."""

    def close(self, kill: bool) -> None:
        """End the workers; with `kill` busy ones die at once, without it they finish their jobs."""
        for worker in self._workers if kill else ():
            worker.process.terminate()
        for worker in self._workers if kill else ():
            worker.process.join(PATIENCE_S)
            worker.process.kill()
        self._threads.shutdown()
        for worker in self._workers:
            worker.pipe.close()
            worker.process.join()


class _Worker:
    """One worker process, our end of the pipe to it, and its latest job."""

    job: Future[Any]

    def __init__(self) -> None:
        self.pipe, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_work, args=(theirs,))
        self.process.start()
        theirs.close()
        self.died = False

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """The result of a job in the process. Raises what the job raises, or `WorkerDied`."""
        begun = None
        try:
            self.pipe.send((function, arguments))
            self._received()
            begun = time.monotonic()
            result, error = self._received()
        except (EOFError, OSError):
            self.died = True
            raise WorkerDied(None if begun is None else time.monotonic() - begun) from None
        if error is not None:
            raise error
        return result

    def _received(self) -> Any:
        """The next thing that the process sends. Raises `EOFError` if it is dead."""
        # A child of a dead process may keep the other end of the pipe open.
        connection.wait([self.pipe, self.process.sentinel])
        if not self.pipe.poll():
            raise EOFError
        return self.pipe.recv()


def _work(pipe: connection.Connection) -> None:
    """The main function of a worker process: run jobs until the pipe is closed. For each job it sends None, when the
    job begins, and then the outcome.

    Ctrl-C is left to the parent. On SIGTERM the process ends in order, and it ends when the parent does: a worker
    without a parent must not continue to write into a dataset.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _terminate)
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_die_with, args=(parent.sentinel,), daemon=True).start()
    # An error of the pipe means that nobody reads any more.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            pipe.send(_outcome_of_next(pipe))


def _outcome_of_next(pipe: connection.Connection) -> tuple[Any, Exception | None]:
    """What the next job returns, or raises; one of the two is None."""
    # Local here, so that an idle worker keeps no samples of a shard.
    function, arguments = pipe.recv()
    pipe.send(None)
    try:
        return function(*arguments), None
    except Exception as error:
        # The parent sees only its own part of the stack.
        error.add_note("".join(traceback.format_tb(error.__traceback__)))
        return None, error


def _terminate(*_: object) -> NoReturn:
    # Python would print a traceback of what this signal interrupts in a destructor.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    raise Ended(1)


def _die_with(sentinel: int) -> None:
    """Wait until the parent process is gone, then end this process."""
    connection.wait([sentinel])
    main = threading.main_thread().ident
    assert main is not None
    signal.pthread_kill(main, signal.SIGTERM)
    time.sleep(PATIENCE_S)
    os._exit(1)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes that are started inside the block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Delay what ends this process until the end of the block: a worker that is half started would not be known, and
    not be ended.

    A terminal sends Ctrl-C to all processes; those that are started inside the block inherit its mask and never get
    it. The mask alone is not enough, as another thread of this process may take the signal, and Python then runs the
    handler in the main thread.
    """
    waiting = list[int]()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    # Only the main thread may have handlers, and they run in no other.
    own = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in numbers if own}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    for number in handlers:
        signal.signal(number, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for received in waiting:
            signal.raise_signal(received)


class DaskCluster:
    """The workers of a Dask cluster that share a file system; without `scheduler` a cluster is started here.
    Attributes as of `LocalProcesses`."""

    # The samples of a shared shard would all pass through the scheduler.
    shares_shards = False

    def __init__(self, workers: int, scheduler: str | None) -> None:
        # The package has no annotations, and may not be installed.
        dask: Any = importlib.import_module("distributed")
        self.deaths: tuple[type[BaseException], ...] = (dask.KilledWorker, BrokenExecutor)
        self._cluster = None
        if scheduler is None:
            with _environment(OF_WORKERS):
                # Dask starts the dashboard's server even without a dashboard. On a free port it disturbs no other
                # cluster of this machine.
                self._cluster = dask.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                )  # fmt: skip
        self._dask, self._scheduler = dask, scheduler
        try:
            self._connect()
        except (OSError, ValueError, TypeError, TimeoutError) as error:
            # Dask raises a TypeError for an address with tls if there are no certificates.
            raise InputError(
                f"{as_given('scheduler', scheduler)}: no Dask scheduler answers there ({error})"
            ) from None
        self._threads, self._count_due = workers, 0.0

    @property
    def capacity(self) -> int:
        """Two jobs for each thread that the cluster has now: one is in reserve, so that no thread waits for this
        process. A cluster without workers gets two, as its first worker may be on its way."""
        now = time.monotonic()
        if now >= self._count_due:
            # A scheduler that is lost is waited for elsewhere (`restore`).
            with suppress(OSError, TimeoutError, RuntimeError):
                if self._client.status == "running":
                    self._threads = sum(self._client.nthreads().values())
            self._count_due = time.monotonic() + COUNT_S
        return 2 * max(self._threads, 1)

    def _connect(self) -> None:
        self._client = self._dask.Client(self._cluster or self._scheduler, timeout=20)
        self._executor = self._client.get_executor(pure=False, retries=0)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """The future of a job. It is cancelled if the scheduler is lost."""
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def restore(self, say: Callable[[str], None]) -> None:
        """Wait until a lost scheduler is back and has a worker; `say` prints a line about that.

        Raises `CheckError` if it takes too long.

        The workers of a lost scheduler end by themselves, so none continues a shard that others then make.
        """
        if self._client.status == "running":
            return
        say(f"the scheduler {self._scheduler} was lost; waiting for it to be there again")
        last = time.monotonic() + RETURN_S
        # A client that gives up would print a traceback after the line above.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        while True:
            self._client.close(timeout=1)
            try:
                self._connect()
                self._client.wait_for_workers(1, timeout=max(last - time.monotonic(), 1.0))
                return
            except (OSError, TimeoutError):
                if time.monotonic() > last:
                    raise CheckError(
                        f"{as_given('scheduler', self._scheduler)}: was lost, and has not been there again with a "
                        f"worker for {RETURN_S:g} s; what is committed stays, run the same command when it is"
                    ) from None

    def close(self, kill: bool) -> None:
        """Disconnect from the cluster, and end it if it was started here."""
        self._executor.shutdown(wait=not kill)
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()


Engine = LocalProcesses | DaskCluster


def check_workers(workers: int) -> None:
    """Raise `InputError` unless `workers` is a whole number in 1 … `MOST_WORKERS`."""
    if not isinstance(workers, int) or isinstance(workers, bool) or not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"{as_given('workers', workers)}: must be ≥ 1 and ≤ {MOST_WORKERS}, one a core")


def check_engine(engine: str, workers: int, scheduler: str | None) -> None:
    """Raise `InputError` for an unknown engine, a wrong number of workers, a scheduler without Dask, and if Dask is
    needed and not installed."""
    check_workers(workers)
    if not isinstance(engine, str) or engine not in ("local", "dask"):
        raise InputError(f"{as_given('engine', engine)}: must be local or dask")
    if engine == "local" and scheduler is not None:
        raise InputError(
            f"{as_given('scheduler', scheduler)}: only {as_given('engine', 'dask')} has a scheduler; add it, "
            "or leave this out"
        )
    if engine == "dask" and importlib.util.find_spec("distributed") is None:
        raise InputError(
            f"{as_given('engine', engine)}: the package distributed is not installed; "
            "pip install nlos-datagen[cluster]"
        )


@contextmanager
def running_engine(engine: str, workers: int, scheduler: str | None) -> Iterator[Engine]:
    """The engine, which is closed at the end of the block; an exception in the block kills busy workers."""
    running: Engine = LocalProcesses(workers) if engine == "local" else DaskCluster(workers, scheduler)
    try:
        yield running
        running.close(kill=False)
    except BaseException:
        running.close(kill=True)
        raise
