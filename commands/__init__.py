"""Commands that have a module of their own: ``NAME``, ``HELP``, ``add_arguments(sub)``, ``call(options)``.

A module parses, calls and prints; it computes nothing and imports nothing heavy before it is called.
"""

from types import ModuleType


def modules() -> tuple[ModuleType, ...]:
    """The commands' modules, in the order of ``towline --help``."""
    from . import (
        app,
        blind,
        campaign,
        check,
        compare,
        completion,
        datum,
        diagnose,
        doctor,
        export,
        import_,
        init,
        lens,
        plan,
        rectify,
    )

    return (
        init,
        app,
        campaign,
        check,
        diagnose,
        blind,
        compare,
        datum,
        lens,
        plan,
        rectify,
        doctor,
        completion,
        import_,
        export,
    )
