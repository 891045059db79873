"""Contact with the dock by two sources, in every order."""

from itertools import product

from diffbot_control.goals.dock_contact import DockContact

OPEN, CLOSED = "open", "closed"
POWER, NO_POWER, UNKNOWN = "power", "no power", "unknown"
REPORTS = {
    OPEN: lambda contact: contact.on_switch(False),
    CLOSED: lambda contact: contact.on_switch(True),
    POWER: lambda contact: contact.on_charger(True),
    NO_POWER: lambda contact: contact.on_charger(False),
    UNKNOWN: lambda contact: contact.on_charger(None),
}


def test_contact_is_a_closed_switch_or_power_whatever_the_other_source_reported_when():
    for reports in product(REPORTS, repeat=4):
        contact = DockContact()
        assert not contact.touches
        for number, report in enumerate(reports, start=1):
            REPORTS[report](contact)
            switch = [one for one in reports[:number] if one in (OPEN, CLOSED)][-1:]
            battery = [one for one in reports[:number] if one in (POWER, NO_POWER)][-1:]
            assert contact.touches == (switch == [CLOSED] or battery == [POWER]), reports[:number]
