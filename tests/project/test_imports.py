"""Who may import whom, read from the source; and what the live path must not load."""

import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import pytest
from places import ROOT
from source_tree import MAY_IMPORT, MODULES, folder, imported, imports_between_folders

#: Folders and modules that only those load who train, measure or compare.
OFFLINE = {"evaluation", "baselines", "bench", "training"}
#: What a running face is made of: these folders' own files, and this module.
LIVE_FOLDERS = {
    "lipservo.runtime",
    "firmware_bridge.loop",
    "firmware_bridge.process",
    "calibration.run",
    "lipsync.motion",
    "lipsync.recognition",
}
LIVE_MODULES = {"lipsync.animpho.synthesizer"}


def test_a_module_imports_only_packages_to_its_left():
    known, found = {*MAY_IMPORT, "config"}, {}
    for module in sorted(MODULES):
        package = module.split(".")[0]
        packages = {name.split(".")[0] for name in imported(module)}
        found[module] = packages & known - MAY_IMPORT[package] - {package}

    assert {module: packages for module, packages in found.items() if packages} == {}


def test_no_module_imports_itself_by_way_of_others():
    graph = {module: imported(module) & set(MODULES) for module in MODULES}

    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_no_folder_imports_itself_by_way_of_others():
    """Each folder is a node, a folder and the one above it are two."""
    graph = imports_between_folders()
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = error.args[1][::-1]
        steps = pairwise(circle)
        told = [" imports ".join(graph[one][other]) for one, other in steps]
        pytest.fail("a circle of folders: " + ", ".join(told))


def test_only_the_bridge_knows_a_bus_by_its_name():
    """A bus is one entry of `firmware_bridge.bus_kinds`; who asks for its name, asks there."""
    names = ("dynamixel", "simulator", "maestro", "pca9685", "feetech")
    buses = tuple(f"firmware_bridge.{name}" for name in names)
    knowing = {
        module: sorted(name for name in imported(module) if name.startswith(buses))
        for module in MODULES
        if not module.startswith((*buses, "lipservo_lab"))
    }

    assert {module: names for module, names in knowing.items() if names} == {}


def is_offline(module):
    """Whether a part of its name is one of `OFFLINE`, or names training: `network_training`."""
    parts = module.split(".")
    return bool(OFFLINE & set(parts)) or any(part.endswith("_training") for part in parts)


def test_nothing_live_imports_what_is_only_for_training_and_measuring():
    """Live is whatever a running face loads, by way of other live modules."""
    roots = {module for module in MODULES if folder(module) in LIVE_FOLDERS} | LIVE_MODULES
    live, waiting, found = set(), sorted(roots), set()
    while waiting:
        module = waiting.pop()
        if module in live:
            continue
        live.add(module)
        for other in sorted(imported(module) & set(MODULES)):
            if is_offline(other):
                found.add((module, folder(other)))
            else:
                waiting.append(other)

    assert found == set()


def test_every_live_place_exists():
    """Renamed, it would be watched no longer."""
    assert {folder(module) for module in MODULES} >= LIVE_FOLDERS
    assert set(MODULES) >= LIVE_MODULES


def printed(script, *arguments):
    """What a process of its own prints that runs these lines, as `lipservo` with arguments."""
    command = [sys.executable, "-c", f"import sys; sys.argv[1:] = {arguments}\n{script}"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


#: lipservo as it is typed, and its exit status.
MAIN = (
    "from lipservo.__main__ import main\n"
    "try:\n    main()\n"
    "except SystemExit as end:\n    ended = end.code\n"
)
HEAVY = "print(*sorted({'sklearn', 'scipy', 'torch', 'sounddevice'} & set(sys.modules)))"


def test_the_live_path_starts_without_heavy_libraries():
    """Whichever of these modules loads one first is named before it."""
    live = (
        *("firmware_bridge.loop.bridge", "firmware_bridge.simulator.bus"),
        *("lipservo.settings.settings", "lipservo.runtime.servos.assembly"),
        *("lipsync.recognition.network_recognizer", "lipsync.recognition.fallback"),
        *("lipservo.dashboard.pages.pages", "lipservo.dashboard.web.serving"),
        *("lipservo.dashboard.web.photo_routes", "lipservo.dashboard.twin.element"),
    )
    script = "\n".join(f"import {module}; print('{module}:', end=' '); {HEAVY}" for module in live)

    assert printed(script).splitlines() == [f"{module}: " for module in live]


def test_a_face_in_memory_loads_nothing_that_speaks_to_a_servo():
    """Of Dynamixel, as which its servos are written down, the tables and the checks alone."""
    script = (
        "from firmware_bridge.clock import ManualClock\n"
        "from lipservo.runtime.servos.assembly import bus_for, load_settings\n"
        "face, _ = load_settings('face_sim')\n"
        "with bus_for(face, ManualClock()) as bus:\n    bus.read()\n"
        "print(*sorted(n for n in sys.modules if n.startswith(('firmware_bridge.dynamixel.', "
        "'serial', 'firmware_bridge.simulator.'))))"
    )

    assert printed(script).split() == [
        "firmware_bridge.dynamixel.control_table",
        "firmware_bridge.dynamixel.kind",
        "firmware_bridge.dynamixel.settings",
        "firmware_bridge.simulator.bus",
        "firmware_bridge.simulator.kind",
    ]


def test_a_whole_replay_loads_no_training_library():
    replay = ("replay", "lipservo/clips/welcome.flac", "-q")

    assert printed(f"{MAIN}assert not ended\n{HEAVY}", *replay).split() == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("stop", "--control", "/none.sock"),
        ("status", "--control", "/none.sock"),
        ("limp", "--help"),
    ],
    ids=["stop", "status", "limp"],
)
def test_whoever_stands_beside_the_robot_waits_for_no_numpy(arguments):
    said = printed(f"{MAIN}print('numpy' in sys.modules)", *arguments)

    assert said.splitlines()[-1] == "False"


def test_reading_settings_does_not_load_numpy():
    script = "import lipservo.settings.settings; print('numpy' in sys.modules)"

    assert printed(script) == "False\n"
