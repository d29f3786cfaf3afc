"""`python -m syncline_logger` is `syncline`."""

from syncline_logger.start import main

main()
