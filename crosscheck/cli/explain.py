"""`crosscheck explain`: explain a name of the output, such as a check or a verdict."""

from __future__ import annotations

import click

from crosscheck.cli.shared import AGREE, cli, say


@cli.command(
    "explain",
    arguments={"[NAME]...": "Level, check, verdict, cause, finding or difference, as commands print it."},
    examples={
        "list all names": "crosscheck explain",
        "explain a level of comparison": "crosscheck explain trajectories",
        "explain a cause of an error": "crosscheck explain soft constraints",
    },
)
@click.argument("name", nargs=-1)
def explain_command(name: tuple[str, ...]) -> int:
    """Explain a check, verdict, cause or finding of the output.

    An explanation has what was compared, how the tolerance follows, what a failure usually means, and what to
    do next. Without NAME, the command lists all names.
    """
    from crosscheck.report.explain import explain, explanation_lines, topics

    if not name:
        for topic in topics():
            say(topic.title, bold=True)
            say(f"  {'; '.join(each.name for each in topic.explanations)}")
        say("", "`crosscheck explain NAME` explains a name.")
        return AGREE  # exit status 0
    for number, (topic, explanation) in enumerate(explain(" ".join(name))):
        heading, *lines = explanation_lines(topic, explanation)
        say(*([""] if number else []))
        say(heading, bold=True)
        say(*lines)
    return AGREE
