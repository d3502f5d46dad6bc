"""What only machines with lists by super-tile have (`spec.supertiles`).

    batch_masks      the tiles of a batch's places, as words by tile
    batch_visits     the visits of a batch's tiles, and the places of their entries
    batch_buffer     places of super-tiles in, visits with their entries out
"""
