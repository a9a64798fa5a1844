"""Work in pieces, by processes of this machine or of a Dask cluster, by joblib.

What all pieces share is sent to each process once. A piece knows of no other, so that its result is the same whoever
works on it, and after whatever else.
"""

import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Generic, TypeVar

from hgogen.errors import BadArgument
from hgogen.reading.given import count
from hgogen.registry import library

MOST_JOBS = 1000  # processes
PATIENCE = "10s"  # until a scheduler answers
Shared = TypeVar("Shared")
Piece = TypeVar("Piece")
Result = TypeVar("Result")


class NoScheduler(BadArgument):
    """A scheduler that does not answer."""


@dataclass(frozen=True, eq=False)
class Workers(Generic[Shared]):
    """Who works: `jobs` processes, None for one for each core, 1 for none but this; or a cluster, of which `scheduler`
    is the address. `shared` is what every piece of work is told.

    Raises: `BadGain` for jobs that are no number.
    """

    shared: Shared
    jobs: int | None = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None:
            count("jobs", self.jobs, 1, MOST_JOBS)

    def results(self, work: Callable[[Shared, Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Those of `work(shared, piece)`, as they come, in no order; `work`: a function of a module. Raises:
        `NoScheduler`; `NotInstalled` without the package of a cluster; what work raises."""
        if self.jobs == 1 and self.scheduler is None:
            yield from (work(self.shared, piece) for piece in pieces)
            return
        from joblib import Parallel, delayed, parallel_config

        client: Any = nullcontext()
        backend = "loky"
        if self.scheduler:
            distributed = library("distributed", f"scheduler {self.scheduler}", "cluster")
            try:
                client, backend = distributed.Client(self.scheduler, timeout=PATIENCE), "dask"
            except (OSError, ValueError) as error:
                raise NoScheduler(f"scheduler {self.scheduler}", f"does not answer: {error}") from None
        with client, parallel_config(backend=backend):
            parallel = Parallel(n_jobs=self.jobs or -1, return_as="generator_unordered", batch_size=1)
            yield from parallel(delayed(_worked)(work, self._sent, piece) for piece in pieces)

    @cached_property
    def _sent(self) -> bytes:
        return pickle.dumps(self.shared)


@lru_cache(maxsize=4)
def _opened(sent: bytes) -> Any:
    return pickle.loads(sent)


def _worked(work: Callable[[Any, Any], Any], sent: bytes, piece: Any) -> Any:
    return work(_opened(sent), piece)
