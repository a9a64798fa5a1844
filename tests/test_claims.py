"""The names of claims: texts that know their parts."""

import copy
import json
import pickle

import numpy as np
import pytest
from plants import MODELS, model

import hgogen as hg
from hgogen import excitation
from hgogen.certificates.certificate import certificate
from hgogen.check import Check, ClaimId, Claims, UnknownCheck, Verdict, refuted
from hgogen.model import load
from hgogen.run.gramian import Gramian

TEXTS = {
    "triangular.a_3": ("triangular", "a", 3),
    "block_triangular.a_1_2": ("block_triangular", "a", 1, 2),
    "phase.rank": ("phase", "rank"),
    "updated_gain.p_1": ("updated_gain", "p_1"),
    "record": ("", "record"),
}
ENTRY = ClaimId("triangular", "a", 3)


@pytest.mark.parametrize("text", TEXTS)
def test_a_name_is_the_text_of_its_parts(text: str) -> None:
    maker, fact, *at = TEXTS[text]
    id = ClaimId(maker, fact, *at)
    assert (id, hash(id), repr(id), f"{id}") == (text, hash(text), repr(text), text)
    assert json.loads(json.dumps([id])) == [text]
    assert (id.maker, id.fact, id.at) == (maker, fact, tuple(at))
    assert id == (f"{maker}.{id.unqualified}" if maker else id.unqualified)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_pickled_name_knows_its_parts(protocol: int) -> None:
    again(pickle.loads(pickle.dumps(ENTRY, protocol)))


def test_a_copied_name_knows_its_parts() -> None:
    again(copy.copy(ENTRY))
    again(copy.deepcopy(Check(ENTRY, "a claim", Verdict.PROVED, "a reason")).id)


def again(id: ClaimId) -> None:
    assert type(id) is ClaimId
    assert (id, id.maker, id.fact, id.at) == (ENTRY, "triangular", "a", (3,))


@pytest.mark.parametrize(
    ("claims", "holds"),
    [
        (Claims("triangular", "a"), True),
        (Claims("triangular"), True),
        (Claims(fact="a"), True),
        (Claims(), True),
        (Claims("block_triangular", "a"), False),
        (Claims("triangular", "offset"), False),
        (Claims("triang"), False),
        (Claims(fact="a_3"), False),
    ],
)
def test_claims_of_a_maker_about_a_fact(claims: Claims, holds: bool) -> None:
    assert (ENTRY in claims) is holds


def test_what_a_user_names_is_nobodys_claim() -> None:
    assert ClaimId("", "a") not in Claims()
    assert ClaimId("", "a") not in Claims(fact="a")


def test_a_record_is_named_by_the_user_and_certified_as_nothing_else() -> None:
    """Whatever the name says."""
    form = hg.forms.triangular(model("pendulum"))
    zero, one = np.zeros(1), np.ones(1)
    hidden = Gramian(1.0, ("q", "w"), zero, zero, one, np.array([[0.0, 1.0]]))
    for name in ("triangular.a_1", "uniform.slope_1", "triangular.structure"):
        check = excitation.shown(name, hidden)
        assert (check.id, check.verdict) == (name, Verdict.REFUTED)
        (claim,) = certificate(form, (check,))["claims"]
        assert (claim["id"], claim["verdict"]) == (name, "stated")


def test_what_bounds_a_slope_in_x_is_no_evidence_of_one_in_z() -> None:
    """phi is shown to be Lipschitz in x, and claimed to be in z: that is stated, with the reason of the check."""
    form = hg.forms.phase(model("pendulum"))
    (check,) = form.about("lipschitz")
    (claim,) = (claim for claim in certificate(form, form.checks)["claims"] if claim["id"] == check.id)
    assert check.verdict is Verdict.PROVED
    assert (claim["verdict"], claim["evidence"]) == ("stated", {"reason": f"proved: {check.reason}"})


def test_every_claim_of_a_form_is_a_name_with_parts() -> None:
    plants = [load(MODELS / name).plant for name in ("pendulum.py", "geared_motor.py", "battery.toml")]
    rows = [row for plant in plants for row in hg.survey(plant, deep=True).rows]
    ids = {check.id for row in rows if row.form for check in row.form.checks}
    assert {id.maker for id in ids} == {*hg.forms.__all__}
    assert all(type(id) is ClaimId for id in ids)


def test_a_claim_that_is_made_later_may_be_accepted() -> None:
    known, later = Check(ENTRY, "a claim", Verdict.REFUTED, "a reason"), ClaimId("observer", "decay")
    assert refuted((known,), (ENTRY, later), (later,)) == ()
    assert refuted((known,), (later,), (later,)) == (known,)
    with pytest.raises(UnknownCheck, match=r"did you mean observer\.decay"):
        refuted((known,), ("observer.decai",), (later,))


def test_a_plain_text_is_a_name_of_the_users_own() -> None:
    """Of no maker, so that nothing of the package takes it for a claim of its own; a certificate states it."""
    own = hg.Check("triangular.lipschitz", "mine", Verdict.PROVED, "by hand")
    assert own.id == "triangular.lipschitz"
    assert own.id not in Claims("triangular", "lipschitz")
    form = load("pendulum").step().observer.form
    (claim,) = hg.certificate(form, (own,))["claims"]
    assert (claim["id"], claim["verdict"]) == ("triangular.lipschitz", "stated")
