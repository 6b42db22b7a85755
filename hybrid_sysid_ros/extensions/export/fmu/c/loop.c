static int begin(fmu_instance *instance)
{
    fmu_values *values = &instance->values;

    if (!@{unit}_init(&values->unit)) {
        return 0;
    }
    @{unit}_reset(&values->unit);
    memcpy(values->command.inputs, values->unit.command, sizeof values->command.inputs);
    return 1;
}

static void stand(fmu_instance *instance)
{
    (void)instance;
}

/* A period. Where a step has several, the measurement is that of the first one, and missing in the others. */
static int step(fmu_instance *instance, int first)
{
    fmu_values *values = &instance->values;
    @{unit}_measurement measurement;
    @{unit}_reference reference;
    int k, j;

    measurement.time = values->time;
    for (j = 0; j < @{UNIT}_OUTPUTS; j++) {
        measurement.outputs[j] = first ? values->outputs[j] : NAN;
    }
    for (j = 0; j < @{UNIT}_INPUTS; j++) {
        measurement.applied[j] = values->applied_given ? values->applied[j] : values->command.inputs[j];
    }
    for (k = 0; k < @{UNIT}_HORIZON; k++) {
        for (j = 0; j < @{UNIT}_OUTPUTS; j++) {
            reference.outputs[k * @{UNIT}_OUTPUTS + j] =
                values->preview_given ? values->preview[j][k] : values->reference[j];
        }
    }
    @{unit}_step(&values->unit, &measurement, &reference, &values->command);
    @{unit}_prepare(&values->unit, PERIOD);
    return 1;
}
