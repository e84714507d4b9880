"""The commands that a person beside the robot waits for, alone: nothing else is loaded."""

import typer

from lipservo.commands.run.servo import servo
from lipservo.commands.run.set_value import set_value
from lipservo.commands.run.stop import limp, start, status, stop

app = typer.Typer(name="lipservo", pretty_exceptions_enable=False)
for command in (stop, start, status, limp, servo):
    app.command()(command)
# A number may be negative, which looks like an option.
app.command("set", context_settings={"ignore_unknown_options": True})(set_value)
