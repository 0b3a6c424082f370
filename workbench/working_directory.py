"""Keeping the process's working directory where it is while others rely on it.

PyMeshLab moves the whole process into a temporary folder while a filter runs, and back. A
process that is started meanwhile would begin in a folder that is soon gone.
"""

from __future__ import annotations

import threading

# Held by whoever lets the working directory change, and by whoever starts processes.
WORKING_DIRECTORY = threading.Lock()
