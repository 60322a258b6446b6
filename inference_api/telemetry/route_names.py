"""Templates of routes: the names of paths in metrics and logs, which no client can add to."""

import re
from collections.abc import Sequence
from functools import cached_property

from fastapi.routing import iter_route_contexts
from starlette.routing import BaseRoute, Mount, compile_path

UNKNOWN = "unknown"


class RouteNames:
    """The templates of an app's routes.

    Args:
        routes: of the app; looked at when the first name is asked for, for routes are added until then.
    """

    def __init__(self, routes: Sequence[BaseRoute]) -> None:
        self._routes = routes

    def of(self, path: str) -> str:
        """The template that a path fits, whether or not the route takes the method; else ``unknown``."""
        return next((name for pattern, name in self._patterns if pattern.match(path)), UNKNOWN)

    @cached_property
    def _patterns(self) -> list[tuple[re.Pattern[str], str]]:
        patterns = []
        for route in iter_route_contexts(self._routes):
            path = route.path or ""
            whole = f"{path}/{{path:path}}" if isinstance(route.original_route, Mount) else path
            patterns.append((compile_path(whole)[0], path))
        return patterns
