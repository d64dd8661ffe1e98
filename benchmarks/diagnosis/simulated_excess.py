"""Excesses of captures with a cause that no catalogue holds, by name of the cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import excess_image
import excess_light
import excess_sensor
import excess_uncovered
import made_causes
import numpy as np
from cboxlab.validation.diagnose.field_fit import ResidualData
from excess_laboratory import Laboratory, Maker, Truth, of_scene

__all__ = ["CAUSES", "excess_of"]

#: By name, every cause.
CAUSES: Mapping[str, Maker] = {
    **{
        maker.__name__: of_scene(maker)
        for maker in (
            made_causes.ball,
            made_causes.rod,
            made_causes.thread,
            made_causes.floor_stain,
            made_causes.wall_stain,
            made_causes.soot,
            made_causes.bleached,
            made_causes.second_lamp,
            made_causes.sun_blade,
            made_causes.pilot_light,
        )
    },
    **{
        maker.__name__: maker
        for maker in (
            excess_sensor.row_offsets,
            excess_sensor.column_offsets,
            excess_sensor.amplifier_glow,
            excess_sensor.hum,
            excess_sensor.light_leak,
            excess_sensor.old_darks,
            excess_sensor.hot_pixels,
            excess_sensor.wrong_bit,
            excess_sensor.old_flats,
            excess_sensor.frost,
            excess_sensor.dust,
            excess_sensor.dust_everywhere,
            excess_sensor.fibre,
            excess_sensor.column_gains,
            excess_sensor.smooth_gain,
            excess_sensor.rings,
            excess_sensor.wedge_fringes,
            excess_image.wedged_filter,
            excess_image.sagging_tripod,
            excess_image.warped_sensor,
            excess_image.smear,
            excess_image.tilted_sensor,
            excess_image.wiped_lens,
            excess_image.fogged_lens,
            excess_image.soft_band,
            excess_image.pane,
            excess_image.lens_ghost,
            excess_image.mirror_ghost,
            excess_image.double_exposure,
            excess_image.trailing_charge,
            excess_sensor.lamp_step,
            excess_sensor.lamp_drift,
            excess_sensor.flicker,
            excess_sensor.persistence,
            excess_light.hotter_lamp,
            excess_light.gas_lines,
            excess_light.uneven_lamp_by_colour,
            excess_light.aged_paints,
            excess_light.other_batch,
            excess_light.red_leak,
            excess_light.next_filters_light,
            excess_light.wrong_table,
            excess_light.gradient,
            excess_light.shiny_plate,
            excess_light.velvet,
            excess_light.window,
            excess_uncovered.cosmic_rays,
            excess_uncovered.compression,
            excess_uncovered.heat_haze,
            excess_uncovered.moved_block,
            excess_uncovered.telegraph_noise,
            excess_uncovered.torn_frame,
            excess_uncovered.sound,
        )
    },
}


def excess_of(name: str, seed: int, lab: Laboratory) -> tuple[Truth, ResidualData]:
    """The excess of a laboratory's capture with a cause, and the truth about it."""
    draw = np.random.default_rng([seed, *name.encode()])
    truth, change, others = CAUSES[name](draw, lab)
    return truth, replace(lab.data.with_change(change), **others)
