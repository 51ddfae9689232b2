"""The logger `hplan` of the standard library; silent until the program adds a handler.

Levels: INFO for results (plans, splices, stops, compiled kernels), WARNING for refused frames and blocked motions,
DEBUG for the stages of a plan. Errors are raised and not logged as such.
"""

from __future__ import annotations

import logging

LOG = logging.getLogger("hplan")
LOG.addHandler(logging.NullHandler())
