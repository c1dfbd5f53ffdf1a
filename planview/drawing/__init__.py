"""How people and the floor are drawn, the same in every picture: colours, image, plan view."""
