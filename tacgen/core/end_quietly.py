"""Ctrl-C ends the process that workers are copied from while it imports, without a traceback.

Imported first by that process, which is started with the signal blocked.
"""

import os
import signal

signal.signal(signal.SIGINT, lambda *_: os._exit(130))
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
