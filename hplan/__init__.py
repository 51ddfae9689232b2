"""hplan: motion planning for fruit-harvesting arms.

The names below load on first use, so that `import hplan` costs next to nothing.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
