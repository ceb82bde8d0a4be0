"""The player that the artist chose: speakers, an actuator, or a sound card with an actuator behind it where nothing but
Blender's own sound is there."""

from __future__ import annotations

from ..actuator.sound import Player, Sound
from .device import Speakers


class OutputRouter:
    """A Player that asks at every play() which output is chosen. Only one of them sounds."""

    def __init__(self) -> None:
        self._speakers = Speakers()
        self._playing: Player = self._speakers

    def play(self, sound: Sound) -> None:
        wanted = self._select_player()
        if wanted is not self._playing:
            self._playing.stop()
            self._playing = wanted
        wanted.play(sound)

    def change(self, sound: Sound) -> None:
        if self._playing.is_playing and self._select_player() is self._playing:
            self._playing.change(sound)
        else:
            self.play(sound)

    def stop(self) -> None:
        self._playing.stop()

    def pause(self) -> None:
        self._playing.pause()

    def resume(self) -> None:
        self._playing.resume()

    def update(self) -> None:
        """Called now and then: what has faded out ends, and what waited for that begins."""
        self._speakers.update()

    @property
    def is_playing(self) -> bool:
        return self._playing.is_playing

    @property
    def is_sounding(self) -> bool:
        return self._playing.is_sounding

    @property
    def is_paused(self) -> bool:
        return self._playing.is_paused

    @property
    def position_s(self) -> float:
        return self._playing.position_s

    def use_shared_device(self, shared: bool) -> bool:
        """The timeline begins or ends to play: speakers sound on Blender's own device meanwhile. True where they are
        what is chosen."""
        from ..actuator.choice import get_selected_output, needs_offline_player
        from ..actuator.state import SPEAKERS

        self._speakers.use_shared_device(shared)
        return get_selected_output() == SPEAKERS or needs_offline_player(get_selected_output())

    def release(self) -> None:
        self._playing.release()
        self._speakers.release()
        self._playing = self._speakers

    def _select_player(self) -> Player:
        from ..actuator.choice import get_selected_output, needs_offline_player
        from ..actuator.state import SPEAKERS

        target = get_selected_output()
        if target == SPEAKERS:
            return self._speakers
        if needs_offline_player(target):
            from .whole import OfflinePlayer

            return self._playing if isinstance(self._playing, OfflinePlayer) else OfflinePlayer(self._speakers)
        from ..actuator.link import PLAYER_CLIENT

        return PLAYER_CLIENT
