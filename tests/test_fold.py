"""Lines of C are no wider than COLUMNS, also where calls nest."""

import pytest

from hgogen.emit.code import COLUMNS, folded

NESTED = (
    "        const bool t2 = magnetic_levitation_within(t1*magnetic_levitation_abs("
    "magnetic_levitation_clamp(s->xi_p[0], 0.005f, 0.03f))*10.0f, 1e+15f);"
)


@pytest.mark.parametrize("line", [NESTED, NESTED.replace("t1*", "t1/"), NESTED.replace("t1*", "x[1]*")])
def test_a_line_whose_calls_nest_is_broken_in_a_product(line: str) -> None:
    parts = folded([line])
    assert len(parts) > 1
    assert all(len(part) <= COLUMNS for part in parts)
    assert "".join(part.strip() for part in parts).replace(" ", "") == line.replace(" ", "")


@pytest.mark.parametrize("ends", ["{}", "[]"])
def test_a_list_of_many_values_is_a_block_of_one_indent(ends: str) -> None:
    values = ", ".join(f"{(-1) ** k * k / 8}f" for k in range(1000))
    line = f"    static const float c[1000] = {ends[0]}{values}{ends[1]};"
    first, *block, last = folded([line])
    assert (first, last) == (f"    static const float c[1000] = {ends[0]}", f"    {ends[1]};")
    assert {len(part) - len(part.lstrip()) for part in block} == {8}
    assert all(COLUMNS // 2 < len(part) <= COLUMNS for part in block[:-1])
    assert " ".join(part.strip() for part in block) == values
