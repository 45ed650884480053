"""The first gamepad of this machine, by pygame, the one file that imports it: SDL knows the devices."""

from __future__ import annotations

import os
from collections.abc import Iterator

from agents.wish import Wish
from deploy.person.stick import stick_wish

LOOK_MS = 10
BRAKE, LEAVE = 0, 1
"""Buttons: A and B of most."""

HELP = "left stick: pull; first button (A): brake while it is held; second button (B): leave"


class NoGamepad(Exception):
    """None is there, or nothing that reads it."""


def wishes() -> Iterator[Wish | None]:
    """None when there is a gamepad, then at each look the new wish, or None if it is the one before. Ends when the
    gamepad is unplugged.

    Raises:
        NoGamepad: see there.
    """
    os.environ |= {
        "SDL_VIDEODRIVER": "dummy",
        "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
        "SDL_NO_SIGNAL_HANDLERS": "1",
    }
    os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
    try:
        import pygame
    except ModuleNotFoundError:
        raise NoGamepad(
            "--gamepad needs pygame-ce; expected the extra `gamepad`: pip install 'palanquin[gamepad]'"
        ) from None
    pygame.display.init()  # without a window, but events come through it
    pygame.joystick.init()
    if not pygame.joystick.get_count():
        raise NoGamepad("--gamepad: no gamepad is there; connect one, or lead with --keyboard")
    pad = pygame.joystick.Joystick(0)
    if pad.get_numaxes() < 2:
        raise NoGamepad(f"--gamepad: {pad.get_name()} has {pad.get_numaxes()} axes; expected two or more")
    before = Wish()
    yield None
    while True:
        for event in pygame.event.get():
            if event.type == pygame.JOYDEVICEREMOVED and event.instance_id == pad.get_instance_id():
                return
        pressed = [number < pad.get_numbuttons() and bool(pad.get_button(number)) for number in (BRAKE, LEAVE)]
        wish = stick_wish(pad.get_axis(0), pad.get_axis(1), brake=pressed[0], leave=pressed[1])
        yield wish if wish != before else None
        before = wish
        pygame.time.wait(LOOK_MS)
