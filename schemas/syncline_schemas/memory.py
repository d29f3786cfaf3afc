"""How the process keeps memory between one batch and the next."""

import numpy as np

KEPT_BYTES = 16 << 20
"""Arrays up to this size are made in memory that was used before."""


def keep_freed_memory() -> None:
    """Make the allocator keep what is freed: batches come and go by the megabyte.

    glibc returns arrays of more than 128 KiB to the system, which has to give and clear the same
    pages again for the next batch: a third of the time of reading. From the first large array on
    that it frees, it keeps those up to that size (`mallopt(3)`, M_MMAP_THRESHOLD). Nothing is
    written into it, so that it takes no memory. Of no effect on other systems.
    """
    np.empty(KEPT_BYTES, np.uint8)
