"""Whether what a user gives can be sent to a worker."""

from __future__ import annotations

import pickle
from multiprocessing.context import get_spawning_popen

from datagen.errors import InputError


def check_sendable(name: str, value: object) -> None:
    """Raise `InputError` if a worker is being started by spawn or forkserver and `pickle` cannot send `value`.

    Other senders, such as cloudpickle, send more, and are not asked here.
    """
    if value is None or get_spawning_popen() is None:
        return
    try:
        pickle.dumps(value)
    except Exception as error:
        what = " ".join(str(error).split())
        raise InputError(
            f"{name}: cannot be sent to a worker that is started afresh ({what}); define it at the top of a module, "
            "or start workers by fork"
        ) from None
