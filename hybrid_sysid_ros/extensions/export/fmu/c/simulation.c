static int begin(fmu_instance *instance)
{
    @{unit}_init(&instance->values.unit);
    return 1;
}

static void stand(fmu_instance *instance)
{
    @{unit}_stand(&instance->values.unit);
}

static int step(fmu_instance *instance, int first)
{
    int i;

    (void)first;
    @{unit}_step(&instance->values.unit);
    for (i = 0; i < @{UNIT}_STATES; i++) {
        if (!isfinite(instance->values.unit.state[i])) {
            refused(instance, "State %d is no longer a finite number.", i);
            return 0;
        }
    }
    return 1;
}
