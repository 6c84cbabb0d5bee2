"""A window on the screen that shows pictures (the extra `manywake[window]`)."""

from typing import Any

import numpy as np


class Window:
    """Shows pictures, (height, width, 3) uint8, until it is closed."""

    def __init__(self, title: str):
        try:
            import pygame
        except ImportError as error:
            remedy = "install it with: pip install 'manywake[window]', or take render_mode='rgb_array'"
            raise RuntimeError(
                f"render_mode: 'human' needs pygame, which cannot be loaded ({error}); {remedy}"
            ) from error
        self._pygame, self._title = pygame, title
        self._screen: Any = None

    def show(self, picture: np.ndarray) -> None:
        """Show a picture, and let the window answer its system."""
        height, width, _ = picture.shape
        if self._screen is None:
            self._pygame.display.init()
            self._screen = self._pygame.display.set_mode((width, height))
            self._pygame.display.set_caption(self._title)
        self._screen.blit(self._pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        self._pygame.event.pump()
        self._pygame.display.flip()

    def close(self) -> None:
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
