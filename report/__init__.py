"""Pictures and pages; the only room that imports matplotlib, and only inside functions."""

from .page import RunPage, write_page
from .terminal import derivatives_table, steady_sources_table, steady_table

__all__ = ["RunPage", "derivatives_table", "steady_sources_table", "steady_table", "write_page"]
