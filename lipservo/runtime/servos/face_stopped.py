"""How a command ends after a person has stopped its face."""

from firmware_bridge.stopping import ExitStatus, StopReport


class FaceStopped(Exception):  # noqa: N818 - what a person asked for is no error
    """A person stopped the face before the command was done; carries what the servos reported."""

    def __init__(self, report: StopReport, signal_number: int | None) -> None:
        super().__init__(report.text())
        self.report = report
        self.signal_number = signal_number

    @property
    def exit_status(self) -> int:
        """See `exit_status`; 5 in place of 0, for what was begun is not there."""
        return exit_status(self.report, self.signal_number) or ExitStatus.STOPPED_EARLY


def exit_status(report: StopReport, signal_number: int | None) -> int:
    """0; after a signal 128 + its number, as shells count; 3 when a servo did not confirm."""
    if not report.complete:
        return ExitStatus.UNCONFIRMED
    return 0 if signal_number is None else 128 + signal_number
