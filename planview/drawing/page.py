"""Pages that are one file: a room's template with the style sheet that all pages share."""

from __future__ import annotations

from typing import Any


def page_of(package: str, template: str, **values: Any) -> str:
    """A template filled in; everything is escaped, and a name that is missing is an error.

    Args:
        package: the room that holds the template, e.g. "planview.output.report".
        template: its file name; it may include style.css.j2.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(package, "."), PackageLoader("planview.drawing", ".")])
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template(template).render(**values)
