"""Drawn conference rooms."""

import numpy as np

from planview.synthetic.camera import ground_camera
from planview.synthetic.random_scenes.rooms import random_conference


def test_room_of_a_seed_is_always_the_same_and_of_another_seed_another() -> None:
    assert random_conference(3).scene == random_conference(3).scene
    assert random_conference(3).scene.camera != random_conference(4).scene.camera


def test_room_fills_with_twelve_people_who_all_leave() -> None:
    people = random_conference(1).scene.people
    assert len(people) == 12
    assert all(person.leaves for person in people)
    seats = [step.on for person in people for step in person.steps if step.sit_s]
    assert len(seats) == len(set(seats)) >= 8


def test_middle_of_a_standing_person_on_the_zone_is_in_the_image() -> None:
    drawn = random_conference(2)
    assert drawn.scene.camera is not None
    corners = np.array(drawn.zone_m)
    u, v = ground_camera(drawn.scene.camera).project(np.column_stack([corners, np.full(len(corners), 0.8)])).T
    assert ((u >= 0) & (u < 320) & (v >= 0) & (v < 240)).all()
