"""Who may import whom, read from the source; and what the live path must not load."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter

import pytest
from places import ROOT

ALLOWED = {
    "lipsync": set(),
    "firmware_bridge": set(),
    "calibration": {"lipsync"},
    "lipservo": {"lipsync", "calibration", "firmware_bridge"},
}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for name in ALLOWED for path in (ROOT / name).rglob("*.py")}


def imported(module):
    """Every module that `module` imports, at its top or inside a function, by its full name."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import on line {node.lineno}"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & set(MODULES)
            found |= submodules or {node.module}
    return found


@pytest.mark.parametrize("module", sorted(MODULES))
def test_a_module_imports_only_packages_to_its_left(module):
    package = module.split(".")[0]
    packages = {name.split(".")[0] for name in imported(module)}

    assert packages & set(ALLOWED) <= ALLOWED[package] | {package}
    assert "config" not in packages


def test_no_module_imports_itself_by_way_of_others():
    graph = {module: imported(module) & set(MODULES) for module in MODULES}

    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


@pytest.mark.parametrize(
    "module",
    [
        "firmware_bridge.loop.bridge",
        "firmware_bridge.simulator.bus",
        "lipservo.settings.settings",
        "lipsync.recognition.network_recognizer",
        "lipsync.recognition.fallback",
        "lipservo.face.assembly",
    ],
)
def test_the_live_path_starts_without_heavy_libraries(module):
    heavy = {"sklearn", "scipy", "torch", "sounddevice"}
    script = f"import sys, {module}; print(*sorted({heavy} & set(sys.modules)))"
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert answer.stdout.split() == []


def test_a_whole_replay_loads_no_training_library():
    script = (
        "import sys; sys.argv[1:] = ['replay', 'lipservo/clips/welcome.flac', '-q']\n"
        "from lipservo.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code\n"
        "print(*sorted({'sklearn', 'scipy', 'torch', 'sounddevice'} & set(sys.modules)))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert answer.stdout.split() == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["stop", "--control", "/none.sock"],
        ["status", "--control", "/none.sock"],
        ["limp", "--help"],
    ],
    ids=["stop", "status", "limp"],
)
def test_whoever_stands_beside_the_robot_waits_for_no_numpy(arguments):
    script = (
        f"import sys; sys.argv[1:] = {arguments}\n"
        "from lipservo.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit:\n    pass\n"
        "print('numpy' in sys.modules)"
    )
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert answer.stdout.splitlines()[-1] == "False"


def test_reading_settings_does_not_load_numpy():
    script = "import sys, lipservo.settings.settings; print('numpy' in sys.modules)"
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )

    assert answer.stdout.strip() == "False"
