"""Folders built by CMake, natively, for a Cortex-M4F and from other projects; manifests by their ecosystems' checks."""

import json
import re
from pathlib import Path

import emitted
import pytest
from emitted import M4F, run, step, tool
from test_folder import lying, made

import hgogen as hg
from hgogen.emit.naming import prefixed
from hgogen.extras.folder import chosen, folder

USE = """
cmake_minimum_required(VERSION 3.16)
project(firmware LANGUAGES C)
{how}
add_executable(firmware main.c)
target_link_libraries(firmware PRIVATE {libraries})
"""
MAIN = """
#include "pendulum.h"
int main(void)
{
    pendulum_state s;
    pendulum_params p;
    pendulum_init(&s, &p);
    return 0;
}
"""
TOOLCHAIN = f"""
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_C_FLAGS_INIT "{" ".join(M4F)}")
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
"""


def configured(source: Path, *options: str) -> Path:
    """The folder of a build, where warnings of CMake are errors."""
    tool("ninja")
    build = source.with_name(f"{source.name}_build")
    run([tool("cmake"), "-G", "Ninja", "-Werror=dev", "-S", str(source), "-B", str(build), *options], source)
    return build


def built(source: Path, *options: str) -> Path:
    """The folder of a build that is made."""
    build = configured(source, *options)
    run(["cmake", "--build", str(build)], source)
    return build


def project(where: Path, how: str, libraries: str = "pendulum::pendulum", main: str = MAIN) -> Path:
    """Another project, which takes the folder."""
    hg.write({"CMakeLists.txt": USE.format(how=how, libraries=libraries), "main.c": main}, where)
    return where


@pytest.mark.full
def test_built_by_itself_it_tests_itself_and_is_installed_for_others(tmp_path: Path) -> None:
    build = built(lying("pendulum", tmp_path), f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'installed'}")
    said = run(["ctest", "--test-dir", str(build), "-V"], tmp_path)
    assert "100% tests passed, 0 tests failed out of 2" in said
    assert "pendulum: 64 samples as recorded" in said
    run(["cmake", "--install", str(build)], tmp_path)
    places = {str(path.relative_to(tmp_path / "installed")) for path in (tmp_path / "installed").rglob("*.*")}
    assert {"include/pendulum.h"} < places
    assert not {place for place in places if "check" in place or "example" in place}
    other = project(tmp_path / "other", "find_package(pendulum REQUIRED)")
    run([str(built(other, f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}") / "firmware")], tmp_path)


@pytest.mark.full
def test_that_a_self_check_that_fails_is_seen(tmp_path: Path) -> None:
    """So that the test above cannot pass on nothing."""
    where = lying("pendulum", tmp_path)
    source = (where / "src" / "pendulum.c").read_text()
    assert "19.6f" in source
    (where / "src" / "pendulum.c").write_text(source.replace("19.6f", "19.7f"))
    build = built(where)
    with pytest.raises(AssertionError, match="pendulum_check"):
        run(["ctest", "--test-dir", str(build)], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        "add_subdirectory(${CMAKE_SOURCE_DIR}/../pendulum pendulum)",
        "include(FetchContent)\nFetchContent_Declare(pendulum SOURCE_DIR ${CMAKE_SOURCE_DIR}/../pendulum)\n"
        "FetchContent_MakeAvailable(pendulum)",
    ],
)
def test_another_project_takes_the_folder_and_none_of_its_tests(how: str, tmp_path: Path) -> None:
    lying("pendulum", tmp_path)
    build = built(project(tmp_path / "other", f"enable_testing()\n{how}"))
    run([str(build / "firmware")], tmp_path)
    assert "No tests were found" in run(["ctest", "--test-dir", str(build)], tmp_path)


@pytest.mark.full
def test_two_observers_of_one_plant_are_in_one_project(tmp_path: Path) -> None:
    for name, gain in (("left", 10), ("right", 20)):
        form = hg.forms.triangular(step("pendulum").observer.form.system)
        one = prefixed(hg.sample(hg.observers.high_gain(form, theta=gain, poles=(-1, -1)), dt=1e-3), name)
        hg.write(folder(one, hg.targets.c99(one), chosen("cmake", name)), tmp_path / name)
    how = "".join(f"add_subdirectory(../{name} {name})\n" for name in ("left", "right"))
    main = '#include "left.h"\n#include "right.h"\nunsigned left_check(void);\nunsigned right_check(void);\n'
    main += "int main(void)\n{\n    return (int)(left_check() + right_check());\n}\n"
    other = project(tmp_path / "other", how, "left::left right::right", main)
    listed = (other / "CMakeLists.txt").read_text()
    checks = "main.c ../left/src/left_check.c ../right/src/right_check.c"
    (other / "CMakeLists.txt").write_text(listed.replace("main.c", checks))
    run([str(built(other) / "firmware")], tmp_path)


@pytest.mark.full
def test_for_a_cortex_m4f_it_is_a_library_alone(tmp_path: Path) -> None:
    tool("arm-none-eabi-gcc")
    (tmp_path / "m4f.cmake").write_text(TOOLCHAIN)
    build = built(lying("pendulum", tmp_path), f"-DCMAKE_TOOLCHAIN_FILE={tmp_path / 'm4f.cmake'}")
    assert (build / "libpendulum.a").exists()
    assert not (build / "pendulum_check").exists()
    assert "VFPv4" in run([tool("arm-none-eabi-readelf"), "-A", "libpendulum.a"], build)


ESP = """
function(idf_component_register)
    cmake_parse_arguments(GIVEN "" "" "SRCS;INCLUDE_DIRS" ${ARGN})
    set(COMPONENT_LIB __idf_pendulum PARENT_SCOPE)
    add_library(__idf_pendulum STATIC ${GIVEN_SRCS})
    target_include_directories(__idf_pendulum PUBLIC ${GIVEN_INCLUDE_DIRS})
endfunction()
set(ESP_PLATFORM 1)
add_subdirectory(../pendulum pendulum)
"""
ZEPHYR = """
function(zephyr_library_named name)
    add_library(${name} STATIC)
    set(ZEPHYR_CURRENT_LIBRARY ${name} PARENT_SCOPE)
endfunction()
function(zephyr_library_sources)
    target_sources(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
endfunction()
function(zephyr_library_sources_ifdef feature)
    if(${feature})
        target_sources(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
    endif()
endfunction()
function(zephyr_library_compile_options)
    target_compile_options(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
endfunction()
function(zephyr_include_directories)
    set_property(DIRECTORY ${CMAKE_SOURCE_DIR} APPEND PROPERTY INCLUDE_DIRECTORIES ${ARGN})
endfunction()
set(CONFIG_HGOGEN_PENDULUM y)
set(CONFIG_HGOGEN_PENDULUM_CHECK y)
add_subdirectory(../pendulum/zephyr pendulum)
"""


@pytest.mark.ordinary("zephyr")
@pytest.mark.parametrize(
    ("how", "library"), [(ESP, "__idf_pendulum"), (ZEPHYR, "hgogen_pendulum")], ids=["esp-idf", "zephyr"]
)
def test_a_component_and_a_module_build_with_stubs_of_their_systems(how: str, library: str, tmp_path: Path) -> None:
    lying("pendulum", tmp_path)
    other = project(tmp_path / "other", how, library)
    run([str(built(other) / "firmware")], tmp_path)
    commands = run(["ninja", "-C", f"{other}_build", "-t", "commands"], tmp_path)
    assert re.findall(r"-ffp-contract=off .*?(\w+)\.c\b", commands) == (
        ["pendulum", "pendulum_check"] if library.startswith("hgogen") else ["pendulum"]
    )


# --- the checks of the ecosystems ---------------------------------------------------------------------------


def test_platformio_takes_its_manifest(tmp_path: Path) -> None:
    manifest = pytest.importorskip("platformio.package.manifest.parser", reason="there is no platformio")
    schema = pytest.importorskip("platformio.package.manifest.schema").ManifestSchema()
    where = lying("pendulum", tmp_path, "platformio")
    read = manifest.ManifestParserFactory.new_from_file(str(where / "library.json")).as_dict()
    assert schema.load_manifest(read)["name"] == "pendulum"
    assert all((where / each["base"] / file).exists() for each in read["examples"] for file in each["files"])


def test_arduino_s_properties_are_read_by_platformio_too(tmp_path: Path) -> None:
    manifest = pytest.importorskip("platformio.package.manifest.parser", reason="there is no platformio")
    schema = pytest.importorskip("platformio.package.manifest.schema").ManifestSchema()
    where = lying("pendulum", tmp_path, "arduino")
    read = manifest.ManifestParserFactory.new_from_file(str(where / "library.properties")).as_dict()
    assert schema.load_manifest({key: value for key, value in read.items() if value})["headers"] == ["pendulum.h"]


def test_the_component_manager_takes_its_manifest(tmp_path: Path) -> None:
    tools = pytest.importorskip("idf_component_tools.manager", reason="there is no idf-component-manager")
    manager = tools.ManifestManager(lying("pendulum", tmp_path, "esp-idf"), "pendulum")
    assert manager.validate().validation_errors == []
    assert str(manager.load().version) == json.loads(made("pendulum")["library.json"])["version"]


# of what Zephyr's documentation of modules has, the keys of a module that brings CMake and Kconfig
MODULE = {
    "type": "map",
    "mapping": {
        "name": {"type": "str"},
        "build": {"type": "map", "mapping": {"cmake": {"type": "str"}, "kconfig": {"type": "str"}}},
    },
}


def test_a_module_of_zephyr_has_the_keys_that_it_reads(tmp_path: Path) -> None:
    core = pytest.importorskip("pykwalify.core", reason="there is no pykwalify")
    yaml = pytest.importorskip("ruamel.yaml")
    read = yaml.YAML(typ="safe", pure=True).load(made("pendulum")["zephyr/module.yml"])
    core.Core(source_data=read, schema_data=MODULE).validate()
    where = lying("pendulum", tmp_path, "zephyr")
    assert (where / read["build"]["cmake"] / "CMakeLists.txt").exists()
    assert (where / read["build"]["kconfig"]).exists()


def test_kconfig_reads_the_options(tmp_path: Path) -> None:
    kconfiglib = pytest.importorskip("kconfiglib", reason="there is no kconfiglib")
    where = lying("pendulum", tmp_path, "zephyr")
    around = 'config CPU_HAS_FPU\n\tdef_bool y\nconfig FPU\n\tbool "FPU"\n\tdepends on CPU_HAS_FPU\n'
    (where / "Kconfig").write_text(f'{around}rsource "zephyr/Kconfig"\n')
    read = kconfiglib.Kconfig(str(where / "Kconfig"), warn_to_stderr=False)
    assert read.warnings == []
    read.syms["HGOGEN_PENDULUM"].set_value("y")
    assert (read.syms["FPU"].str_value, read.syms["HGOGEN_PENDULUM_CHECK"].visibility) == ("y", 2)


def test_every_ecosystem_that_is_built_here_is_the_same_folder() -> None:
    """So that what is tested of `all` holds of each."""
    for path, text in made("pendulum").items():
        for each in ("cmake", "platformio", "arduino", "zephyr", "esp-idf"):
            alone = made("pendulum", each)
            assert path == "README.md" or alone.get(path, text) == text
    assert emitted.files("pendulum")["pendulum.h"] == made("pendulum")["src/pendulum.h"]
