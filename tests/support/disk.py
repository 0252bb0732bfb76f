"""A disk that fills up, for the tests of whatever writes."""

import resource
from contextlib import contextmanager


@contextmanager
def full_disk(after_bytes: int):
    """Files cannot grow beyond `after_bytes`; writing more fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (after_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
