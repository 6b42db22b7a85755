/* ------------------------------------------------------------------ variables */

static const fmu_variable *found(const fmu_instance *instance, fmi3ValueReference reference, enum fmu_kind kind)
{
    int k;

    for (k = 0; k < VARIABLES; k++) {
        if (variables[k].reference == reference && variables[k].kind == kind) {
            return &variables[k];
        }
    }
    refused(instance, "There is no variable of this type with the value reference %lu.", (unsigned long)reference);
    return NULL;
}

static void *place(fmu_instance *instance, const fmu_variable *variable)
{
    return (char *)&instance->values + variable->offset;
}

static int may_set(const fmu_instance *instance, const fmu_variable *variable)
{
    if (variable->access == ALWAYS || (variable->access == BEFORE && instance->mode < STEPPING)) {
        return 1;
    }
    refused(instance, "%s can't be set%s.", variable->name, variable->access == BEFORE ? " after the first step" : "");
    return 0;
}

fmi3Status fmi3GetFloat64(fmi3Instance given, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    fmu_instance *instance = given;
    size_t k, done = 0;

    for (k = 0; k < nValueReferences; k++) {
        const fmu_variable *variable = found(instance, valueReferences[k], FLOAT64);

        if (variable == NULL) {
            return fmi3Error;
        }
        if (variable->size > nValues - done) {
            return refused(instance, "There is room for %lu values only.", (unsigned long)nValues);
        }
        memcpy(values + done, place(instance, variable), variable->size * sizeof *values);
        done += variable->size;
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance given, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    fmu_instance *instance = given;
    size_t k, i, done = 0;

    for (k = 0; k < nValueReferences; k++) {
        const fmu_variable *variable = found(instance, valueReferences[k], FLOAT64);

        if (variable == NULL || !may_set(instance, variable)) {
            return fmi3Error;
        }
        if (variable->size > nValues - done) {
            return refused(instance, "There are %lu values only.", (unsigned long)nValues);
        }
        for (i = 0; i < variable->size && variable->checked; i++) {
            const double value = values[done + i];

            if (!(isfinite(value) && value >= variable->low && value <= variable->high)) {
                return refused(instance, "%s is %g, which is outside of [%g, %g].", variable->name, value,
                               variable->low, variable->high);
            }
        }
        memcpy(place(instance, variable), values + done, variable->size * sizeof *values);
        done += variable->size;
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance given, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Boolean values[], size_t nValues)
{
    fmu_instance *instance = given;
    size_t k;

    for (k = 0; k < nValueReferences && k < nValues; k++) {
        const fmu_variable *variable = found(instance, valueReferences[k], BOOLEAN);

        if (variable == NULL) {
            return fmi3Error;
        }
        values[k] = *(const int *)place(instance, variable) != 0;
    }
    return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance given, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Boolean values[], size_t nValues)
{
    fmu_instance *instance = given;
    size_t k;

    for (k = 0; k < nValueReferences && k < nValues; k++) {
        const fmu_variable *variable = found(instance, valueReferences[k], BOOLEAN);

        if (variable == NULL || !may_set(instance, variable)) {
            return fmi3Error;
        }
        *(int *)place(instance, variable) = values[k];
    }
    return fmi3OK;
}

fmi3Status fmi3GetInt64(fmi3Instance given, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Int64 values[], size_t nValues)
{
    fmu_instance *instance = given;
    size_t k;

    for (k = 0; k < nValueReferences && k < nValues; k++) {
        const fmu_variable *variable = found(instance, valueReferences[k], ENUMERATION);

        if (variable == NULL) {
            return fmi3Error;
        }
        values[k] = *(const int *)place(instance, variable);
    }
    return fmi3OK;
}
