"""What worker processes of this machine load first: Ctrl-C is meant for the run that ends them."""

import signal
from contextlib import suppress

# Only the main thread may say so; a worker in another one gets no signals.
with suppress(ValueError):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
