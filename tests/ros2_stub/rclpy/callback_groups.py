class MutuallyExclusiveCallbackGroup:
    pass
