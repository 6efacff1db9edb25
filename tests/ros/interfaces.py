"""Python types of the interfaces in a folder, such as the `nav2_msgs` that no wheel has.

    python tests/ros/interfaces.py FOLDER

makes them with the generators of ROS and the C compiler of this machine, below FOLDER, which is
then a place for `PYTHONPATH`, and its folder `lib` one for `LD_LIBRARY_PATH`. All of a package is
one extension module, which has the names of its libraries of type support as well.
"""

import importlib.util
import json
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

HERE = Path(__file__).parent
PACKAGES = HERE / "bond", HERE / "nav2_msgs"
PREFIX = Path(sys.prefix)
SHARE, INCLUDE, LIBRARIES = PREFIX / "share", PREFIX / "include", PREFIX / "lib"
SUPPORT, INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
SUPPORTS = "rosidl_typesupport_c", SUPPORT, INTROSPECTION
DEPENDENCIES = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "nav_msgs",
    "service_msgs",
    "std_msgs",
    "unique_identifier_msgs",
)
"""Packages whose messages are parts of those of `nav2_msgs`."""


def missing() -> str:
    """Return what is missing to make the types; empty if nothing is."""
    modules = ("rclpy", "rosidl_adapter", "rosidl_generator_py", SUPPORT)
    lacking = [each for each in modules if importlib.util.find_spec(each) is None]
    lacking += [each for each in ("gcc", "g++") if shutil.which(each) is None]
    if not Path(sysconfig.get_paths()["include"], "Python.h").exists():
        lacking.append("Python.h")
    if not (INCLUDE / "nav_msgs").is_dir():
        lacking.append("headers of nav_msgs")
    return ", ".join(lacking)


def build(out: Path, source: Path) -> None:
    """Make the types of the package `source` below a folder, which is then one for imports."""
    name, generated = source.name, out / f"{source.name}-generated"
    idl = [
        (each.parent.name, convert(source, each, generated))
        for each in sorted([*source.glob("msg/*.msg"), *source.glob("action/*.action")])
    ]
    tuples = [f"{generated}:{folder}/{path.name}" for folder, path in idl]
    generate(name, tuples, generated / name, generated)
    compile_package(name, generated, out / name)


def convert(source: Path, interface: Path, generated: Path) -> Path:
    """Translate a `.msg` or `.action` file to OMG IDL."""
    from rosidl_adapter import convert_to_idl

    return convert_to_idl(source, source.name, interface.relative_to(source), generated)


def generate(name: str, tuples: list[str], out: Path, generated: Path) -> None:
    """Generate the C and C++ sources and the Python modules of a package."""
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    shares = [SHARE / each for each in DEPENDENCIES]
    known = [f"{share.name}:{path}" for share in shares for path in share.glob("*/*.idl")]

    def write(generator: str, **more: object) -> str:
        given = {
            "package_name": name,
            "output_dir": str(out),
            "template_dir": str(SHARE / generator / "resource"),
            "idl_tuples": tuples,
            "ros_interface_dependencies": known,
            "target_dependencies": [],
            **more,
        }
        path = generated / f"{generator}.json"
        path.write_text(json.dumps(given))
        return str(path)

    places = [f"{share.name}:{share}" for share in shares]
    generate_type_hash(write("rosidl_generator_type_description", include_paths=places))
    paths = [each.split(":")[1] for each in tuples]
    described = [f"{path}:{(out / path).with_suffix('.json')}" for path in paths]
    origins = [str(HERE / name / Path(path).with_suffix(f".{Path(path).parent}")) for path in paths]
    generate_c(
        write("rosidl_generator_c", type_description_tuples=described, ros_interface_files=origins)
    )
    generate_typesupport_fastrtps_c(write(SUPPORT))
    # Its files have the names of those of the first generator.
    apart = generated / INTROSPECTION / name
    generate_introspection(write(INTROSPECTION, output_dir=str(apart)))
    generate_dispatch(write("rosidl_typesupport_c"), [SUPPORT, INTROSPECTION])
    generate_py(write("rosidl_generator_py"), ["rosidl_typesupport_c"])
    for generator in ("rosidl_generator_c", SUPPORT, INTROSPECTION):
        header = f"{generator}__visibility_control.h"
        template = (SHARE / generator / "resource" / f"{header}.in").read_text()
        text = template.replace("@PROJECT_NAME_UPPER@", name.upper())
        folder = apart if generator == INTROSPECTION else out
        (folder / "msg").mkdir(parents=True, exist_ok=True)
        (folder / "msg" / header).write_text(text.replace("@PROJECT_NAME@", name))


def compile_package(name: str, generated: Path, package: Path) -> None:
    """Compile the generated sources to an extension module, beside the Python modules."""
    import numpy as np

    sources, apart = generated / name, generated / INTROSPECTION
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    libraries = [
        f"-l{each}__{kind}"
        for each in DEPENDENCIES
        for kind in (*("rosidl_generator_c", "rosidl_generator_py"), *SUPPORTS)
    ]
    headers = [sysconfig.get_paths()["include"], np.get_include(), generated, apart]
    headers += [INCLUDE, *(each for each in INCLUDE.iterdir() if each.is_dir())]
    options = ["-fPIC", "-O0", "-w", *(f"-I{each}" for each in headers)]
    objects = []
    for language, compiler in (("*.c", ["gcc"]), ("*.cpp", ["g++", "-std=c++17"])):
        found = [*sorted(sources.rglob(language)), *sorted(apart.rglob(language))]
        for index, each in enumerate(found):
            objects.append(generated / f"{language[2:]}{index}.o")
            run([*compiler, *options, "-c", str(each), "-o", str(objects[-1])])
    shutil.copytree(sources, package, ignore=shutil.ignore_patterns("*.c", "*.cpp", "*.h"))
    for each in (package, *(path for path in package.iterdir() if path.is_dir())):
        (each / "__init__.py").touch()
    module = package / f"{name}_s__rosidl_typesupport_c{suffix}"
    run(
        [
            *("g++", "-shared", "-o", str(module)),
            *map(str, objects),
            f"-L{LIBRARIES}",
            f"-Wl,-rpath,{LIBRARIES}",
            *libraries,
            *("-lrosidl_runtime_c", *(f"-l{each}" for each in SUPPORTS)),
            *("-lrosidl_typesupport_fastrtps_cpp", "-lfastcdr"),
        ]
    )
    # The dispatch looks for libraries of these names.
    links = package.parent / "lib"
    links.mkdir(exist_ok=True)
    for each in SUPPORTS:
        (links / f"lib{name}__{each}.so").symlink_to(module)


def run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command[:2])}: {done.stderr[-4000:]}"


if __name__ == "__main__":
    for package in PACKAGES:
        build(Path(sys.argv[1]).absolute(), package)
