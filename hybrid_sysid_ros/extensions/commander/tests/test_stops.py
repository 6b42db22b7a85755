"""Stops: whatever people say for one, in five languages, and what is none."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, STOP, stop_in
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs import rig as rigs

SAID = {
    "en": """
        stop | STOP!!! | Stooop | s.t.o.p | S T O P | stpo | halt | abort | freeze! | whoa | cancel |
        cancel that | quit | brake | turn it off | turn the motor off | switch off | shut down | shut it
        all down | power off | halt the swing | hit the brakes | enough | that's enough | hold on! | don't
        move | stand still | knock it off | oh no stop | no, stop! | oh no it is shaking stop | please
        brake | you must abort now | go to 99 V stop | can't you stop |
        never mind | Nevermind! | forget it | no more! | don't continue | never mind, go to 2 V |
        st op | s top | bring it to rest | let it rest |
        do not move stop | don't wait stop | without delay stop | do not go halt | no! | no, no, no! | oh no
    """,
    "pt": """
        pare | PARE | pára! | para | para tudo | para já | meu deus para | não, para! | parar | parem |
        pare agora | chega | basta | desliga | desligue o motor | aborta | cancela | freia | trava |
        pare aí, por favor | PARA AI AGORA | para de girar | dá pra parar | desliga isso aí | tira da tomada | fim |
        em repouso | parada total | interrompe isso | não se mexa | fica quieto | não continue | deixa pra lá |
        esquece isso | não!
    """,
    "es": """
        para ya | párate | deténgase | detente | detener | ¡alto! | basta ya | frena | apágalo | apague el
        motor | PARATE AHI | detén el motor por favor | deja de girar | para un momento | no sigas |
        desactiva el motor |
        desenchufa | suficiente | suelta | cancelar | llévalo al reposo | no te muevas | quieto |
        parad, detened, paren | freno
    """,
    "de": """
        stopp | halt | Halt an! | anhalten | stehen bleiben | bleib sofort stehen | abbrechen | Abbruch |
        brems | bremsen | schalte den Motor aus | mach es aus | aus | hör auf | Hör auf damit! | Schluss |
        halt mal bitte sofort an | hoer bitte auf | HOER AUF DAMIT | jetzt reicht's | lass das | stillhalten | Ruhe |
        genug | bring es zur Ruhe | nicht bewegen | nicht weiter stopp | nein
    """,
    "fr": """
        arrête | ARRÊTEZ | arrête-toi | arrêter | arrêt | stoppez | halte ! | ça suffit | c'est assez |
        arrête-toi là | arrete toi la | ARRETEZ TOUT S IL VOUS PLAIT | reste immobile | débranche |
        laisse tomber | lâche |
        freine | mets-le au repos | coupe le moteur | ne bouge plus | ne bougez pas | annule | non
    """,
}
ALONE = {
    "lass das", "hold on!", "forget it", "no more!", "no!", "no, no, no!", "oh no", "deixa pra lá",
    "esquece isso", "não!",
    "nein", "non",
}  # fmt: skip
"""Stops as whole sentences alone."""
LATCHING = """
    emergency | emergency stop | E-STOP | estop now | cut the power | kill it | pull the plug | emergência |
    parada de emergência | corta a energia | socorro | emergencia | corta la corriente | Not-Aus | NOTAUS |
    emer gency | Nothalt | Not-Halt | NOT-STOPP | zieh den Stecker | arrêt d'urgence | ARRET D URGENCE |
    coupe le courant | fire! | it is burning | fogo! | peligro | Feuer | es brennt | au feu | help! | help me |
    me ajuda | ayuda | Hilfe! | aidez-moi
"""
NEGATED = """
    don't cut the power | don't press the emergency stop | this is not an emergency | not emergency stop | not stop |
    NOT HALT | sem emergência | não é uma emergência | no es una emergencia | kein Notfall | kein Not-Aus |
    pas d'urgence
"""
NONE = """
    don't st op | don't stop | do not ever stop | never stop | go to 3 V without stopping | não pare | no pares |
    n'arrête pas | ne t'arrête pas | nicht anhalten | hör nicht auf | halt nicht an | sem parar | step to 3 V | vai para
    3 graus | de 1 para 2 V | sobe mais alto que 3 | half of 3 V | what is the weather like |
    go no more than 2 V | don't forget to go to 2 V | you need not stop | it must not stop |
    you don't have to stop | don't you ever stop
"""


def listed(text: str) -> list[str]:
    return [" ".join(item.split()) for item in text.split("|")]


@pytest.mark.parametrize("text", [text for texts in SAID.values() for text in listed(texts)])
def test_every_word_for_a_stop_stops(text: str) -> None:
    assert stop_in(text) == STOP
    assert stop_in(f"oh my, {text.upper()}") == STOP or text in ALONE
    sentence = grammar.read(text, Vocabulary.of(rigs.load("cam_beam")))
    assert sentence.is_stop
    assert not sentence.emergency


@pytest.mark.parametrize("text", listed(LATCHING))
def test_an_emergency_latches_whatever_else_is_said(text: str) -> None:
    assert stop_in(text) == EMERGENCY
    assert grammar.read(f"go to 1 V, {text}", Vocabulary.of(rigs.load("cam_beam"))).emergency


@pytest.mark.parametrize("text", listed(NEGATED))
def test_an_emergency_in_doubt_stops_without_a_latch_and_says_why(text: str) -> None:
    """In English "not halt" says no stop, and in German it is an emergency stop, without its dash."""
    sentence = grammar.read(text, Vocabulary.of(rigs.load("cam_beam")))
    assert (sentence.is_stop, sentence.emergency) == (True, False)
    assert sentence.because


@pytest.mark.parametrize("text", listed(NONE))
def test_what_asks_for_no_stop_is_none(text: str) -> None:
    assert stop_in(text) == ""


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("go to 2 V and stop in 5 s", "from now, or when the rest is done"),
        ("go to 2 V and stop after 10 s", "from now, or when the rest is done"),
        ("stop when it reaches 100 V", "never reaches 100 V"),
        ("stop and go to 2 V", "a stop ends a command"),
        ("stop unless it is at 2 V", "condition that nobody watches"),
        ("stopp, wenn es über 2 V ist", "unknown word"),
        ("keine Bewegung!", ""),
        ("stop there", ""),
        ("stop, stop!", ""),
        ("arrête", ""),
        ("oh dear stop", ""),
    ],
)
def test_a_stop_in_doubt_is_one_at_once_and_says_why(text: str, why: str) -> None:
    sentence = grammar.read(text, Vocabulary.of(rigs.load("cam_beam")))
    assert sentence.is_stop
    assert why in sentence.because
    assert bool(why) == bool(sentence.because)


@pytest.mark.parametrize(
    ("text", "value"),
    [("stop when the height reaches 33600 m", 72.0), ("when the speed reaches 4600.29 m/s stop", 10.0)],
)
def test_a_stop_at_a_value_in_all_waits_for_it(text: str, value: float) -> None:
    """The vehicle counts from 33 528 m and 4590.29 m/s."""
    condition = grammar.read(text, Vocabulary.of(rigs.load("winged_cone"))).condition
    assert condition is not None
    assert condition.value == pytest.approx(value)


@pytest.mark.parametrize("text", ["help me go to 2 V", "with the help of the controller go to 2 V"])
def test_help_in_a_sentence_is_no_cry(text: str) -> None:
    assert stop_in(text) == ""
