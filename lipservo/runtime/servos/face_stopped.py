"""The exception and the exit status of a command whose face a person has stopped."""

from firmware_bridge.stopping import ExitStatus, StopReport


class FaceStopped(Exception):  # noqa: N818 - what a person asked for is no error
    """The error that a person stopped the face before the command was done.

    report: which servos confirmed torque off. signal_number: None: no signal stopped it.
    """

    def __init__(self, report: StopReport, signal_number: int | None) -> None:
        super().__init__(report.text())
        self.report = report
        self.signal_number = signal_number

    @property
    def exit_status(self) -> int:
        """The exit status: 3 if a servo did not confirm torque off, else 128 + signal number.

        Without a signal: 5.
        """
        return exit_status(self.report, self.signal_number) or ExitStatus.STOPPED_EARLY


def exit_status(report: StopReport, signal_number: int | None) -> int:
    """Return 3 if a servo did not confirm torque off, else 128 + signal number as shells do.

    Without a signal: 0.
    """
    if not report.complete:
        return ExitStatus.UNCONFIRMED
    return 0 if signal_number is None else 128 + signal_number
