"""One file a scene: constants, Scene, action map, observation extras, reward."""
