"""What holds for all tests: programs that they start can be interrupted."""

import signal

# A runner that was started in the background ignores Ctrl-C, and so would every program it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
