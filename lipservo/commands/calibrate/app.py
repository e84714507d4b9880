"""`lipservo calibrate`: a sub-command for each step, and the old spellings refused."""

import shlex
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from lipservo.commands.calibrate import by_files, by_hand, grading, on_servos, single_steps, written
from lipservo.commands.calibrate.old_spelling import new_spelling

_NAMES = (
    *("plan", "fit", "grade", "measure", "guided", "practise"),
    *("by-hand", "pose", "lags", "trim", "show"),
)
#: Degrees may be negative, which looks like an option.
_DEGREES = {"ignore_unknown_options": True}


class CalibrateGroup(TyperGroup):
    """Sub-commands; an option where the name of one belongs is the old spelling, and refused."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Raises BadParameter with the new spelling."""
        is_old = bool(args) and args[0].startswith("-") and args[0] != "--help"
        if is_old and not ctx.resilient_parsing:  # a shell that completes is told nothing
            options = {
                name: [option for parameter in command.params for option in parameter.opts]
                + [option for parameter in command.params for option in parameter.secondary_opts]
                for name, command in self.commands.items()
            }
            new = new_spelling(args, options)
            raise typer.BadParameter(f"this has sub-commands: it is now `{new}`", ctx=ctx)
        return super().parse_args(ctx, args)


app = typer.Typer(cls=CalibrateGroup, invoke_without_command=True)
app.command(epilog=by_files.PLAN_EXAMPLE)(by_files.plan)
app.command(epilog=by_files.FIT_EXAMPLE)(by_files.fit)
app.command(epilog=grading.GRADE_EXAMPLE)(grading.grade)
app.command(epilog=on_servos.MEASURE_EXAMPLE)(on_servos.measure)
app.command(epilog=on_servos.GUIDED_EXAMPLE)(on_servos.guided)
app.command(epilog=on_servos.PRACTISE_EXAMPLE)(on_servos.practise)
app.command("by-hand", epilog=by_hand.BY_HAND_EXAMPLE)(by_hand.by_hand)
app.command(epilog=single_steps.POSE_EXAMPLE)(single_steps.pose)
app.command(epilog=single_steps.LAGS_EXAMPLE)(single_steps.lags)
app.command(epilog=written.TRIM_EXAMPLE, context_settings=_DEGREES)(written.trim)
app.command(epilog=written.SHOW_EXAMPLE)(written.show)


@app.callback()
def calibrate(context: typer.Context) -> None:
    """Find how a speaker's mouth becomes angles of this robot's servos (docs/calibration.md)."""
    if context.invoked_subcommand is None:
        raise typer.BadParameter(f"say what to do: {', '.join(_NAMES)}", ctx=context)


def old_trim(
    context: typer.Context,
    arguments: Annotated[list[str] | None, typer.Argument()] = None,
) -> None:
    """Refused: `lipservo calibrate trim`."""
    words = shlex.join(["lipservo", "calibrate", "trim", *(arguments or ())])
    raise typer.BadParameter(f"it is now `{words}`", ctx=context.parent)
